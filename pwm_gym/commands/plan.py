"""``pwm-gym plan``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pwm_gym.commands.failures import draw_failures
from pwm_gym.commands.numbers import check_least

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

    from pwm_gym.planning import SamplingConfig
    from pwm_gym.tasks import Task

__all__ = ["Plan", "print_success"]


@dataclass(frozen=True)
class Plan:
    """Plan in the model, execute in the simulator: closed loop, in chunks or open loop.

    With ``--save``, a run that was killed goes on where it was.
    """

    task: str = "PickCube"
    """Registered task."""
    checkpoint: str = "default"
    """A folder or a shipped checkpoint's name."""
    episodes: int = 20
    """Seeded episodes."""
    seeds: str = "plan_test"
    """Range of seeds: "plan_test", or "plan_validation" for tuning."""
    offset: int = 0
    """First seed of the range."""
    max_steps: int | None = None
    """Actions of an episode at most; None takes the task's limit."""
    planner: str | None = None
    """mppi, mppi-fine (finer samples), mppi-paper (the paper's settings), cem, icem or gradient; None takes the
    task's."""
    samples: int | None = None
    """Action sequences an iteration; the elites change in proportion. None leaves the planner's own."""
    horizon: int | None = None
    """Steps that each looks ahead."""
    iterations: int | None = None
    """Rounds of sampling an action."""
    chunk: int = 1
    """Actions between two looks: 1 is closed loop, 0 looks at the first scene alone (open loop)."""
    objects: str = ""
    """What episodes draw their objects from, where they differ: one of the task's sets, such as "unseen", or an
    object's name; the task's default if not given."""
    starts: str = ""
    """Where episodes start, of tasks that have several distributions, such as OGBench's evaluation tasks ("tasks")."""
    observation: str = "complete"
    """What the agent sees: complete clouds, "partial" ones, or ones "completed" from a camera's depth."""
    completer: str = "default"
    """Of completed clouds: a checkpoint's folder, "default" or "hull"."""
    sensor: str = "ideal"
    """Sensor model of that camera: ideal or d455."""
    cost: str | None = None
    """Registered cost, or "file.py:function"; None takes the task's planning cost."""
    guide: Path | None = None
    """Folder of a policy that ``pwm-gym train-agent`` wrote: plans start from what it would do in the model, where that
    is cheaper than the last plan."""
    caution: float = 0.0
    """Cost of a metre of expected error at a step."""
    workspace: tuple[float, float, float, float, float, float] | None = None
    """Box that the end effector is to stay in: lowest and highest corner, metres in the robot base's frame."""
    clear_of: tuple[str, ...] = ()
    """Entities that the end effector is not to touch."""
    save: Path | None = None
    """Folder for a record of each run, which ``pwm-gym view`` draws; runs that are there are not planned again."""
    pictures: Path | None = None
    """Folder for a picture of the failed episodes, by the stage that they ended in."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Run the episodes and print the success table."""
        import gymnasium as gym

        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.commands.check_cost import find_cost
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.envs import CameraConfig
        from pwm_gym.errors import unknown_name
        from pwm_gym.evaluation import planning_table, run_episodes, write_results
        from pwm_gym.learning import digest
        from pwm_gym.planning import Agent
        from pwm_gym.process import prepare_process
        from pwm_gym.seeds import RANGES, seed_range
        from pwm_gym.tasks import get_task

        check_least(self, episodes=1, offset=0, chunk=0, threads=1)
        if self.max_steps is not None:
            check_least(self, max_steps=1)
        if self.seeds not in RANGES:
            raise unknown_name("range of seeds", self.seeds, RANGES)
        task = get_task(self.task)
        planner = task.planner if self.planner is None else self.planner
        config = self._config(planner)
        prepare_process(self.threads)
        path = resolve(self.checkpoint, self.task)
        checkpoint = load_checkpoint(path)
        checkpoint.check_joints(task.layout)
        seeds = seed_range(self.seeds, self.episodes, self.offset)
        cost = None if self.cost is None else find_cost(self.cost)
        penalties = self._penalties(task)
        guide = None if self.guide is None else self._policy(self.guide, task)
        limits = {name: getattr(self, name) for name in ("caution", "workspace", "clear_of")}
        agent = Agent(checkpoint.model, self.task, config, cost, penalties=penalties, caution=self.caution, guide=guide)
        camera = CameraConfig(sensor=self.sensor, completer=self.completer)
        twin = f"pwm/{self.task}Sim-v0"
        settings: dict[str, Any] = {"observation": self.observation, "camera": camera, "objects": self.objects or None}
        if self.starts:
            settings["starts"] = self.starts
        most = task.max_episode_steps if self.max_steps is None else self.max_steps
        names = ("chunk", "seeds", "objects", "observation", "completer", "sensor", "cost")
        facts = {"planner": planner, "settings": asdict(config), **{name: getattr(self, name) for name in names}}
        if self.starts:
            facts["starts"] = self.starts
        recipe = {"task": self.task, "checkpoint": digest(path), "max_steps": most, **limits, **facts}
        if self.guide is not None:
            recipe["guide"] = facts["guide"] = digest(self.guide)
        with gym.make(twin, max_episode_steps=most, **settings) as env:
            runs = run_episodes(env, agent, seeds, most, self.chunk, folder=self.save, recipe=recipe)
        table = planning_table(runs)
        mode = {0: "open loop", 1: "closed loop"}.get(self.chunk, f"chunks of {self.chunk}")
        print_success(f"{self.task}, {mode} in the simulator", table)
        failed = [run for run in runs if not run.success]
        if self.pictures is not None and failed:
            table["picture"] = draw_failures(self.pictures, self.task, mode, failed)
            print(f"  pictures         {self.pictures / table['picture']}")
        if self.json is not None:
            write_results(self.json, {**facts, **table})

    def _config(self, planner: str) -> SamplingConfig:
        """The planner's settings with what the options change."""
        from pwm_gym.planning import get_planner_config

        config = get_planner_config(planner)
        if self.samples is not None:
            config = config.resize(self.samples)
        changes = {k: v for k in ("horizon", "iterations") if (v := getattr(self, k)) is not None}
        return replace(config, **changes)

    def _policy(self, folder: Path, task: Task) -> Callable[..., Tensor]:
        """What the policy in a folder does in the task's states.

        Raises:
            CheckpointError: there is no such folder, or none of a policy of the task.
        """
        from pwm_gym.agents.contestants import contestant
        from pwm_gym.errors import CheckpointError

        if not folder.is_dir():
            raise CheckpointError(f"guide={str(folder)!r} is no folder; expected one of pwm-gym train-agent")
        return contestant(str(folder), task).act

    def _penalties(self, task: Task) -> dict[str, Any]:
        """Terms that the constraints add to the cost."""
        from pwm_gym.planning import keep_clear, workspace

        effector = tuple(e.name for e in task.layout if e.driven)
        penalties: dict[str, Any] = {}
        if self.workspace is not None:
            penalties["workspace"] = (100.0, workspace(self.workspace[:3], self.workspace[3:], effector))
        if self.clear_of:
            penalties["clear"] = (10.0, keep_clear(self.clear_of, effector))
        return penalties


def print_success(title: str, table: dict[str, Any]) -> None:
    """Print a table of :func:`pwm_gym.evaluation.planning_table`."""
    low, high = table["interval"]
    latency, steps = table["plan_seconds"], table["mean_steps_of_successes"]
    print(f"\n{title}")
    print(f"  success          {table['successes']}/{table['episodes']}  (95 % interval {low:.0%} to {high:.0%})")
    print(f"  steps to success {steps:.1f} on average" if steps else "  steps to success -")
    print(f"  one action       {latency['median']:.2f} s median, {latency['p95']:.2f} s 95th percentile")
    for stage, count in table["stages"].items():
        print(f"  past {stage:27s} {count}/{table['episodes']}")
    if table["failed_seeds"]:
        print(f"  failed seeds     {', '.join(map(str, table['failed_seeds']))}")
