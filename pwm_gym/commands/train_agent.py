"""``pwm-gym train-agent``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from pwm_gym.agents.config import ALGORITHMS, WORLDS, AgentConfig
from pwm_gym.commands.folders import data_folder, run_folder
from pwm_gym.commands.numbers import check_least
from pwm_gym.errors import PwmGymError, unknown_name
from pwm_gym.policies import CloningConfig, PolicyConfig

if TYPE_CHECKING:
    from pwm_gym.planning import Run
    from pwm_gym.policies import ActsOnPoses
    from pwm_gym.tasks import Task

__all__ = ["TrainAgent"]


@dataclass(frozen=True)
class TrainAgent:
    """Train a policy and test it: by reinforcement learning in a world, or cloned from demonstrations.

    A killed run goes on where it was.
    """

    task: str = "PickCube"
    """Registered task."""
    algo: str = "cloning"
    """"ppo" or "sac" (stable-baselines3), or "cloning" of a data set's demonstrations."""
    world: Annotated[str, tyro.conf.arg(name="in")] = "model"
    """Where ppo and sac learn: in the world "model", or in its simulator twin, "sim"."""
    test_in: str = "sim"
    """Where the policy is tested: "sim" or "model"."""
    out: Path | None = None
    """Folder of the policy. None takes ``runs/``, the task's name and how it was trained."""
    episodes: int = 20
    """Seeded episodes of the test; 0 leaves it out."""
    objects: str = ""
    """What the test's episodes draw their objects from, where they differ; the task's default if not given."""
    json: Path | None = None
    """Where to write the test's results."""
    video: Path | None = None
    """Where to draw the test's first episode: an ``.mp4`` or a GIF."""
    data: Path | None = None
    """Of cloning: folder of a data set. None takes ``data-sets/`` and the task's name."""
    demonstrations: int = 0
    """Of cloning: demonstrations, evenly chosen; 0 takes all."""
    agent: AgentConfig = field(default_factory=AgentConfig)
    network: PolicyConfig = field(default_factory=PolicyConfig)
    training: Annotated[CloningConfig, tyro.conf.arg(name="")] = field(default_factory=CloningConfig)

    def run(self) -> None:
        """Train, with a progress bar and TensorBoard curves, then run the test's episodes."""
        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.tasks import get_task

        check_least(self, demonstrations=0, episodes=0)
        if self.video is not None and not self.episodes:
            raise PwmGymError(f"video={self.video} and episodes=0; expected an episode that it is of")
        known = {"algo": ("cloning", *ALGORITHMS), "world": WORLDS, "test_in": WORLDS}
        for name, values in known.items():
            if getattr(self, name) not in values:
                raise unknown_name(name, getattr(self, name), values)
        task = get_task(self.task)
        policy, took = self._cloned(task) if self.algo == "cloning" else self._learned(task)
        if self.episodes:
            self._test(task, policy, took)

    def _cloned(self, task: Task) -> tuple[ActsOnPoses, dict[str, Any]]:
        """A policy cloned from demonstrations, and what that took."""
        from pwm_gym.policies import clone, cloning_took, load_policy

        data, out = data_folder(task.name, self.data), run_folder(f"{task.name}-cloned", self.out)
        clone(task.name, data, out, self.training, self.network, self.demonstrations)
        took = cloning_took(out)
        print(f"policy: {out}; cloned from {took['demonstrations']} demonstrations")
        return load_policy(out), {"algorithm": "cloning", "training": took}

    def _learned(self, task: Task) -> tuple[ActsOnPoses, dict[str, Any]]:
        """A policy trained in a world, and what that took."""
        from pwm_gym.agents import load_agent, train

        out = run_folder(f"{task.name}-{self.algo}-{self.world}", self.out)
        took = train(task.name, out, replace(self.agent, algorithm=self.algo, world=self.world))
        print(f"policy: {out}; {took['steps']} environment steps in {took['seconds'] / 60:.1f} minutes")
        return load_agent(out, task.name), {"algorithm": self.algo, "world": self.world, "training": took}

    def _test(self, task: Task, policy: ActsOnPoses, took: dict[str, Any]) -> None:
        """Run the test's episodes, and write what came of them."""
        from pwm_gym.commands.plan import print_success
        from pwm_gym.evaluation import episodes_in, planning_table, write_results
        from pwm_gym.policies import PolicyAgent

        agent = PolicyAgent(policy, task.name)
        runs = episodes_in(self.test_in, agent, self.episodes, self.objects, progress=True)
        table = planning_table(runs)
        print_success(f"{task.name}, {self.algo}, tested in the {self.test_in}", table)
        if self.json is not None:
            write_results(self.json, {"objects": self.objects, "tested_in": self.test_in, **took, **table})
        if self.video is not None:
            self._draw(runs[0])

    def _draw(self, run: Run) -> None:
        """A film of a run beside the model's prediction of its actions."""
        from pwm_gym.commands.view import FROM_THE_FIRST, rolled_out, twin_record
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.planning import Agent
        from pwm_gym.viewer import write_gif, write_mp4

        assert self.video is not None
        model = load_checkpoint(resolve(self.agent.checkpoint, self.task)).model
        record = twin_record(rolled_out(run, Agent(model, self.task)), FROM_THE_FIRST)
        shown = replace(record, title=f"{self.task}: {self.algo} in the {self.test_in}")
        print((write_mp4 if self.video.suffix == ".mp4" else write_gif)(shown, self.video))
