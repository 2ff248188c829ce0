"""``pwm-gym bench``."""

from __future__ import annotations

import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pwm_gym.dynamics import WorldModel
    from pwm_gym.scene import Scene
    from pwm_gym.tasks import Task

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
    adapter: int = 256
    """Environments with which stable-baselines3's adapter is compared with the native batch; 0 leaves it out."""
    planners: int = 0
    """Scenes on which our MPPI is compared with those of pytorch_mppi and TorchRL (the extra "planners")."""
    completer: str | None = None
    """Times the way from a view to a scene with this completer: a checkpoint's folder, "default" or "hull"."""
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
        checkpoint = load_checkpoint(resolve("default", task.name))
        scenes = [checkpoint.bank(task.name).scene(i) for i in range(max(1, self.planners))]
        results: dict[str, Any] = {"start": _start(task.name), **self._environments(task)}
        results.update(self._sizes(checkpoint.model, task, scenes[0]))
        if self.planners:
            results["planners"] = benchmarks.compare_planners(checkpoint.model, task, scenes)
        if self.completer is not None:
            results["perception"] = benchmarks.perception_times(task, self.completer)
        results["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        _print(results)
        if self.pictures is not None:
            self._draw(self.pictures, results, task.layout.points)
        if self.json is not None:
            write_results(self.json, results)

    @property
    def _middle(self) -> int:
        """Samples with which the other sizes vary."""
        return sorted(self.samples)[len(self.samples) // 2]

    def _environments(self, task: Task) -> dict[str, Any]:
        from pwm_gym.evaluation import benchmarks

        found: dict[str, Any] = {
            "simulator_steps_per_second": benchmarks.simulator_rate(task, self.seconds),
            "model_steps_per_second": benchmarks.model_rates(task, self.num_envs, self.seconds),
        }
        if self.adapter:
            from pwm_gym.wrappers import SB3VecEnv

            found["adapter"] = {"num_envs": self.adapter}
            found["adapter"] |= benchmarks.adapter_overhead(task, SB3VecEnv, self.adapter)
        return found

    def _sizes(self, model: WorldModel, task: Task, scene: Scene) -> dict[str, Any]:
        """Times of rollouts and plans by their sizes, and the floor of one rollout."""
        from pwm_gym.evaluation import benchmarks

        middle, first = self._middle, self.horizons[0]
        sizes = [(n, first) for n in self.samples] + [(middle, h) for h in self.horizons[1:]]
        plans = [(n, h, task.layout.points) for n, h in sizes]
        plans += [(middle, first, n) for n in self.points if n != task.layout.points]
        return {
            "rollout_seconds": benchmarks.rollout_times(model, scene, sizes),
            "plan_seconds": benchmarks.plan_times(model, task, scene, plans),
            "floor": {"of": f"{middle} x {first}", **benchmarks.rollout_floor(model, scene, middle, first)},
        }

    def _draw(self, folder: Path, results: dict[str, Any], points: int) -> None:
        """How the times of rollouts and plans grow with each of their sizes."""
        from pwm_gym.viewer import draw_growth

        rollouts, plans = results["rollout_seconds"], results["plan_seconds"]
        middle, first = self._middle, self.horizons[0]
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


def _print(results: dict[str, Any]) -> None:
    start, base, floor = results["start"], results["simulator_steps_per_second"], results["floor"]
    print(f"gym.make + reset in a fresh process: {start['seconds']:.2f} s, {start['gib']:.2f} GiB")
    print(f"raw simulator env.step: {base:.0f} steps/s")
    for count, rate in results["model_steps_per_second"].items():
        print(f"make_vec(num_envs={count}): {rate:.0f} steps/s, {rate / base:.1f} times the simulator's")
    if adapter := results.get("adapter"):
        seconds = f"{1e3 * adapter['adapter_seconds']:.1f} ms a step against {1e3 * adapter['native_seconds']:.1f} ms"
        print(f"adapter of {adapter['num_envs']} environments: {seconds}, {adapter['overhead']:+.1%}")
    for kind in ("rollout", "plan"):
        for size, seconds in results[f"{kind}_seconds"].items():
            print(f"{kind} of {size}: {seconds:.3f} s")
    print(
        f"of {floor['of']}: products {floor['product_seconds']:.3f} s, memory {floor['memory_seconds']:.3f} s, "
        f"{floor['operations']:.0f} operations {floor['overhead_seconds']:.3f} s"
    )
    for name, row in results.get("planners", {}).items():
        print(f"{name}: {row['seconds']:.3f} s an action, cost at the end {row['final_cost']:.2f}")
    for name, row in results.get("perception", {}).items():
        print(f"{name} view (ms): {', '.join(f'{stage} {1e3 * s:.0f}' for stage, s in row.items())}")
    print(f"peak memory: {results['peak_gib']:.2f} GiB")


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
