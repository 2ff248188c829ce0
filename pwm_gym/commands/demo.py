"""``pwm-gym demo``: the main job from end to end."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pwm_gym.commands.numbers import check_least

if TYPE_CHECKING:
    import gymnasium as gym

    from pwm_gym.planning import Agent, Run

__all__ = ["Demo"]


@dataclass(frozen=True)
class Demo:
    """Plan in the model, execute in the simulator, and draw both worlds side by side."""

    task: str = "PickCube"
    """Registered task."""
    checkpoint: str = "default"
    """A folder or a shipped checkpoint's name."""
    out: Path = Path("demo")
    """Folder of the pictures."""
    episodes: int = 3
    """Seeded episodes; the first successful one is drawn."""
    cost: str | None = None
    """Registered cost, or "file.py:function", to plan with; None takes the task's planning cost."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Plan, execute, report and draw."""
        import gymnasium as gym

        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.commands.check_cost import find_cost
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.planning import Agent
        from pwm_gym.process import prepare_process
        from pwm_gym.seeds import seed_range
        from pwm_gym.tasks import get_task

        check_least(self, episodes=1, threads=1)
        prepare_process(self.threads)
        task = get_task(self.task)
        checkpoint = load_checkpoint(resolve(self.checkpoint, self.task))
        begun = time.perf_counter()
        env = gym.make(f"pwm/{self.task}Sim-v0")
        print(f"{self.task}: {checkpoint.kind} world model; simulator ready in {time.perf_counter() - begun:.0f} s")
        agent = Agent(checkpoint.model, self.task, cost=None if self.cost is None else find_cost(self.cost))
        runs = [_execute(env, agent, seed, task.max_episode_steps) for seed in seed_range("plan_test", self.episodes)]
        env.close()
        best = next((r for r in runs if r.success), runs[0])
        self._draw(best, agent)
        wins = sum(r.success for r in runs)
        print(f"\nsuccess {wins}/{len(runs)}; pictures of seed {best.seed} in {self.out}/")

    def _draw(self, run: Run, agent: Agent) -> None:
        """GIF and PNG of the run as the model predicts it from the first scene alone, and as it went."""
        from pwm_gym.commands.view import FROM_THE_FIRST, rolled_out, twin_record
        from pwm_gym.viewer import write_gif, write_png

        record = twin_record(rolled_out(run, agent), FROM_THE_FIRST)
        print(
            f"\nfrom the first scene alone, the model predicts all {run.steps} executed actions:"
            f"\n  Chamfer L1 {record.error.mean() * 1e3:.1f} mm on average, {record.error[-1] * 1e3:.1f} mm at the end"
        )
        self.out.mkdir(parents=True, exist_ok=True)
        write_png(record, self.out / "twin.png")
        write_gif(record, self.out / "twin.gif")


def _execute(env: gym.Env[Any, Any], agent: Agent, seed: int, max_steps: int) -> Run:
    """One closed-loop episode, and one printed line."""
    from pwm_gym.planning import execute

    run = execute(env, agent, seed, max_steps)
    result, latency = "success" if run.success else "failure", np.median(run.plan_seconds)
    print(f"  seed {seed}: {result} after {run.steps:3d} steps, {latency:.2f} s an action")
    return run
