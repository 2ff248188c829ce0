"""``pwm-gym demo``: the main job from end to end."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pwm_gym.scene import Scene

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
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Plan, execute, report and draw."""
        import gymnasium as gym

        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.planning import Agent
        from pwm_gym.process import prepare_process
        from pwm_gym.seeds import seed_range

        prepare_process(self.threads)
        checkpoint = load_checkpoint(resolve(self.checkpoint, self.task), self.task)
        begun = time.perf_counter()
        env = gym.make(f"pwm/{self.task}Sim-v0")
        print(f"{self.task}: {checkpoint.kind} world model; simulator ready in {time.perf_counter() - begun:.0f} s")
        agent = Agent(checkpoint.model, self.task)
        takes = [_Take(seed) for seed in seed_range("plan_test", self.episodes)]
        for take in takes:
            take.execute(env, agent)
        env.close()
        best = next((t for t in takes if t.success), takes[0])
        self._draw(best, checkpoint.model)
        wins = sum(t.success for t in takes)
        print(f"\nsuccess {wins}/{len(takes)}; pictures of seed {best.seed} in {self.out}/")

    def _draw(self, take: _Take, model: Any) -> None:
        """GIF and PNG of the plan as the model predicts it from the first scene alone, and as it went."""
        from pwm_gym.viewer import write_gif, write_png

        record = take.record(model, self.task)
        print(
            f"\nfrom the first scene alone, the model predicts all {len(take.actions)} executed actions:"
            f"\n  Chamfer L1 {record.error.mean() * 1e3:.1f} mm on average, {record.error[-1] * 1e3:.1f} mm at the end"
        )
        self.out.mkdir(parents=True, exist_ok=True)
        write_png(record, self.out / "twin.png")
        write_gif(record, self.out / "twin.gif")


@dataclass
class _Take:
    """One executed episode."""

    seed: int
    scenes: list[Scene] = field(default_factory=list)
    actions: list[np.ndarray] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    success: bool = False

    def execute(self, env: Any, agent: Any) -> None:
        """Closed loop in the simulator, one printed line."""
        from pwm_gym.planning import closed_loop

        run = closed_loop(env, agent, self.seed, on_scene=self.scenes.append)
        self.actions, self.rewards, self.success = run.actions, run.rewards, run.success
        result = "success" if run.success else "failure"
        latency = float(np.median(run.plan_seconds))
        print(f"  seed {self.seed}: {result} after {run.steps:3d} steps, {latency:.2f} s an action")

    def record(self, model: Any, task_name: str) -> Any:
        """Both worlds from the first scene on, under the executed actions."""
        import torch

        from pwm_gym.costs import cost_info, get_cost, get_grasp
        from pwm_gym.dynamics import rollout
        from pwm_gym.evaluation import chamfer
        from pwm_gym.scene import batch_state
        from pwm_gym.tasks import get_task
        from pwm_gym.viewer import TwinRecord

        task = get_task(task_name)
        actions = torch.as_tensor(np.stack(self.actions))
        with torch.no_grad():
            states = rollout(model, batch_state([self.scenes[0]]), actions[None])[0]
        first = batch_state([self.scenes[0]]).points()
        predicted = torch.cat([first, states.points()]).numpy()
        true = np.concatenate([batch_state([s]).points().numpy() for s in self.scenes])
        goal = torch.as_tensor(self.scenes[0].goal).expand(len(actions), -1)
        rewards = -get_cost(task.cost)(*cost_info(states, actions, goal, get_grasp(task.grasp))).numpy()
        return TwinRecord(
            predicted=predicted,
            true=true,
            layout=task.layout,
            error=np.array([chamfer(p, q) for p, q in zip(predicted, true, strict=True)]),
            goal=self.scenes[0].goal,
            predicted_reward=np.concatenate([rewards[:1], rewards]),
            true_reward=np.array([self.rewards[0], *self.rewards]),
            title=f"{task.name}: planned in the world model, executed in the simulator",
            subtitle=f"seed {self.seed}; the model sees the first frame only, then the same actions",
        )
