"""``pwm-gym bench``."""

from __future__ import annotations

import resource
import subprocess
import sys
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
    """Time environments, planning and start-up on this machine, in one process."""

    task: str = "PickCube"
    """Registered task."""
    num_envs: tuple[int, ...] = (1, 16, 256, 1024, 4096)
    """Batch sizes of the model's environment."""
    seconds: float = 5.0
    """How long each is stepped."""
    samples: tuple[int, ...] = (50, 100, 200, 400, 800)
    """Action sequences of the rollouts and plans."""
    horizons: tuple[int, ...] = (10, 20, 30)
    """Their steps."""
    points: tuple[int, ...] = (300, 600, 1200)
    """Points of the scenes that plans are made for."""
    planners: int = 0
    """Scenes on which our MPPI is compared with those of pytorch_mppi and TorchRL (the extra "planners")."""
    pictures: Path | None = None
    """Folder for a picture of how the times grow."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Print the tables and write the results."""
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.evaluation import benchmarks, write_results
        from pwm_gym.process import prepare_process
        from pwm_gym.tasks import get_task

        prepare_process(self.threads)
        task = get_task(self.task)
        checkpoint = load_checkpoint(resolve("default", task.name), task.name)
        model, scene = checkpoint.model, checkpoint.bank.scene(0)
        results: dict[str, Any] = {"start": _start(task.name)}
        start = results["start"]
        print(f"gym.make + reset in a fresh process: {start['seconds']:.2f} s, {start['gib']:.2f} GiB")
        results["simulator_steps_per_second"] = base = benchmarks.simulator_rate(task, self.seconds)
        print(f"raw simulator env.step: {base:.0f} steps/s")
        results["model_steps_per_second"] = benchmarks.model_rates(task, self.num_envs, self.seconds)
        for count, rate in results["model_steps_per_second"].items():
            print(f"make_vec(num_envs={count}): {rate:.0f} steps/s, {rate / base:.1f} times the simulator's")
        middle = sorted(self.samples)[len(self.samples) // 2]
        sizes = [(n, self.horizons[0]) for n in self.samples] + [(middle, h) for h in self.horizons[1:]]
        results["rollout_seconds"] = benchmarks.rollout_times(model, scene, sizes)
        plans = [(n, h, task.layout.points) for n, h in sizes]
        plans += [(middle, self.horizons[0], n) for n in self.points if n != task.layout.points]
        results["plan_seconds"] = benchmarks.plan_times(model, task, scene, plans)
        for kind in ("rollout", "plan"):
            for size, seconds in results[f"{kind}_seconds"].items():
                print(f"{kind} of {size}: {seconds:.3f} s")
        floor = results["floor"] = benchmarks.rollout_floor(model, scene, middle, self.horizons[0])
        print(
            f"of {middle} x {self.horizons[0]}: products {floor['product_seconds']:.3f} s, memory "
            f"{floor['memory_seconds']:.3f} s, {floor['operations']:.0f} operations {floor['overhead_seconds']:.3f} s"
        )
        if self.planners:
            scenes = [checkpoint.bank.scene(i) for i in range(self.planners)]
            results["planners"] = benchmarks.compare_planners(model, task, scenes)
            for name, row in results["planners"].items():
                print(f"{name}: {row['seconds']:.3f} s an action, cost at the end {row['final_cost']:.2f}")
        results["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(f"peak memory: {results['peak_gib']:.2f} GiB")
        if self.pictures is not None:
            self._draw(self.pictures, results, middle, task.layout.points)
        if self.json is not None:
            write_results(self.json, results)

    def _draw(self, folder: Path, results: dict[str, Any], middle: int, points: int) -> None:
        """How the times of rollouts and plans grow with each of their sizes."""
        from pwm_gym.viewer import draw_growth

        rollouts, plans, first = results["rollout_seconds"], results["plan_seconds"], self.horizons[0]
        panels: dict[str, dict[str, dict[float, float]]] = {
            "samples": {
                "rollout": {n: rollouts[f"{n} x {first}"] for n in self.samples},
                "plan": {n: plans[f"{n} x {first} x {points}"] for n in self.samples},
            },
            "horizon": {
                "rollout": {h: rollouts[f"{middle} x {h}"] for h in self.horizons},
                "plan": {h: plans[f"{middle} x {h} x {points}"] for h in self.horizons},
            },
            "points of the scene": {"plan": {n: plans[f"{middle} x {first} x {n}"] for n in {*self.points, points}}},
        }
        folder.mkdir(parents=True, exist_ok=True)
        draw_growth(panels, f"{self.task}: time of one rollout, and of one plan's costs").save(folder / "growth.png")


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
