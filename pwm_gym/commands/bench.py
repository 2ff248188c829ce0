"""``pwm-gym bench``."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Bench"]

_START = """
import time, resource
begun = time.perf_counter()
import gymnasium as gym
import pwm_gym
env = gym.make("pwm/{task}-v0")
env.reset(seed=0)
print(time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


@dataclass(frozen=True)
class Bench:
    """Time environments, planning and start-up on this machine."""

    task: str = "PickCube"
    """Registered task."""
    num_envs: tuple[int, ...] = (1, 16, 256)
    """Batch sizes of the model's environment."""
    seconds: float = 5.0
    """How long each is stepped."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Print the table and write the results."""
        from pwm_gym.evaluation import write_results
        from pwm_gym.process import prepare_process

        prepare_process(self.threads)
        results: dict[str, Any] = {"start": _start(self.task)}
        print(
            f"gym.make + reset in a fresh process: {results['start']['seconds']:.2f} s, "
            f"{results['start']['gib']:.2f} GiB"
        )
        results["simulator_steps_per_second"] = base = self._simulator()
        print(f"raw simulator env.step: {base:.0f} steps/s")
        results["model_steps_per_second"] = {n: self._model(n) for n in self.num_envs}
        for count, rate in results["model_steps_per_second"].items():
            print(f"make_vec(num_envs={count}): {rate:.0f} steps/s, {rate / base:.1f} times the simulator's")
        results["rollout_seconds"] = self._rollout()
        print(f"rollout of 200 x 10: {results['rollout_seconds']:.3f} s")
        results["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        if self.json is not None:
            write_results(self.json, results)

    def _simulator(self) -> float:
        """Steps a second of the simulator's own environment under random actions."""
        import gymnasium as gym

        import pwm_gym  # noqa: F401  (registers)

        twin: Any = gym.make(f"pwm/{self.task}Sim-v0").unwrapped
        twin.reset(seed=0)
        raw = twin.simulator.env
        rate = self._rate(lambda: raw.step(raw.action_space.sample()), 1)
        twin.close()
        return rate

    def _model(self, count: int) -> float:
        """Environment steps a second of the native batch under random actions."""
        import gymnasium as gym

        envs = gym.make_vec(f"pwm/{self.task}-v0", num_envs=count)
        envs.reset(seed=0)
        rate = self._rate(lambda: envs.step(envs.action_space.sample()), count)
        envs.close()
        return rate

    def _rate(self, step: Any, count: int) -> float:
        """Environment steps a second of ``step``, which makes ``count``."""
        for _ in range(3):
            step()
        begun, steps = time.perf_counter(), 0
        while time.perf_counter() - begun < self.seconds:
            step()
            steps += count
        return steps / (time.perf_counter() - begun)

    def _rollout(self) -> float:
        """Median seconds of one rollout of 200 sequences of 10 actions."""
        import torch

        from pwm_gym.dynamics import load_checkpoint, resolve, rollout
        from pwm_gym.scene import batch_state

        checkpoint = load_checkpoint(resolve("default", self.task), self.task)
        state = batch_state([checkpoint.bank.scene(0)] * 200)
        actions = torch.rand(200, 10, checkpoint.model.action_size) * 2 - 1
        times = []
        with torch.no_grad():
            for _ in range(10):
                begun = time.perf_counter()
                rollout(checkpoint.model, state, actions)
                times.append(time.perf_counter() - begun)
        return sorted(times)[len(times) // 2]


def _start(task: str) -> dict[str, float]:
    """Seconds and memory of making and resetting the model environment in a fresh process; the best of three."""
    runs = []
    for _ in range(3):
        code = _START.format(task=task)
        done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
        seconds, gib = map(float, done.stdout.split())
        runs.append((seconds, gib))
    seconds, gib = min(runs)
    return {"seconds": seconds, "gib": gib}
