"""``pwm-gym plan``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pwm_gym.commands.crew import crew
from pwm_gym.commands.failures import draw_failures
from pwm_gym.commands.numbers import check_least

if TYPE_CHECKING:
    from collections.abc import Callable

    import gymnasium as gym
    from torch import Tensor

    from pwm_gym.planning import Agent, Run, SamplingConfig
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
    to_the_end: bool = False
    """Whether episodes go on after success, up to the limit: the table then tells of how many it lasted, too."""
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
    workers: int = 1
    """Episodes at once, each in a process of its own."""
    ray: str | None = None
    """Ray cluster whose machines run the episodes instead: "auto", "local" or HOST:PORT (the extra "ray")."""
    threads: int = 2
    """PyTorch threads a process."""

    def run(self) -> None:
        """Run the episodes and print the success table."""
        from pwm_gym.dynamics import resolve
        from pwm_gym.errors import unknown_name
        from pwm_gym.evaluation import planning_table, run_seeds, write_results
        from pwm_gym.learning import digest
        from pwm_gym.seeds import RANGES, seed_range
        from pwm_gym.tasks import get_task

        check_least(self, episodes=1, offset=0, chunk=0, workers=1, threads=1)
        if self.max_steps is not None:
            check_least(self, max_steps=1)
        if self.seeds not in RANGES:
            raise unknown_name("range of seeds", self.seeds, RANGES)
        task = get_task(self.task)
        planner = task.planner if self.planner is None else self.planner
        config, path = self._config(planner), resolve(self.checkpoint, self.task)
        seeds = seed_range(self.seeds, self.episodes, self.offset)
        _agent(self)  # what does not fit ends all before anything is run
        most = self._most(task)
        limits = {name: getattr(self, name) for name in ("caution", "workspace", "clear_of")}
        names = ("chunk", "seeds", "objects", "observation", "completer", "sensor", "cost")
        facts = {"planner": planner, "settings": asdict(config), **{name: getattr(self, name) for name in names}}
        if self.starts:
            facts["starts"] = self.starts
        if self.to_the_end:
            facts["to_the_end"] = True
        recipe = {"task": self.task, "checkpoint": digest(path), "max_steps": most, **limits, **facts}
        if self.guide is not None:
            recipe["guide"] = facts["guide"] = digest(self.guide)
        try:
            run_one, who = partial(_run_one, self), crew(self.workers, self.ray)
            runs = run_seeds(run_one, seeds, folder=self.save, recipe=recipe, workers=who)
        finally:
            _release(self)
        table = planning_table(runs)
        table["at_reset"] = len(seeds) - len(runs)
        if self.to_the_end:
            table["successes_at_the_end"] = sum(run.holds for run in runs)
        mode = {0: "open loop", 1: "closed loop"}.get(self.chunk, f"chunks of {self.chunk}")
        print_success(f"{self.task}, {mode} in the simulator", table)
        failed = [run for run in runs if not run.success]
        if self.pictures is not None and failed:
            table["picture"] = draw_failures(self.pictures, self.task, mode, failed)
            print(f"  pictures         {self.pictures / table['picture']}")
        if self.json is not None:
            write_results(self.json, {**facts, **table})

    def _most(self, task: Task) -> int:
        """Actions of an episode at most."""
        return task.max_episode_steps if self.max_steps is None else self.max_steps

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


@lru_cache(maxsize=1)
def _agent(command: Plan) -> Agent:
    """The command's planner, made once a process."""
    from pwm_gym.commands.check_cost import find_cost
    from pwm_gym.dynamics import load_checkpoint, resolve
    from pwm_gym.planning import Agent
    from pwm_gym.process import prepare_process
    from pwm_gym.tasks import get_task

    prepare_process(command.threads)
    task = get_task(command.task)
    checkpoint = load_checkpoint(resolve(command.checkpoint, task.name))
    checkpoint.check_joints(task.layout)
    config = command._config(task.planner if command.planner is None else command.planner)
    cost = None if command.cost is None else find_cost(command.cost)
    penalties = command._penalties(task)
    guide = None if command.guide is None else command._policy(command.guide, task)
    settings: dict[str, Any] = {"penalties": penalties, "caution": command.caution, "guide": guide}
    return Agent(checkpoint.model, task.name, config, cost, **settings)


@lru_cache(maxsize=1)
def _twin(command: Plan) -> gym.Env[Any, Any]:
    """The command's simulator, made once a process."""
    import gymnasium as gym

    import pwm_gym  # noqa: F401  (registers)
    from pwm_gym.envs import CameraConfig
    from pwm_gym.tasks import get_task

    most = command._most(get_task(command.task))
    camera = CameraConfig(sensor=command.sensor, completer=command.completer)
    settings: dict[str, Any] = {"observation": command.observation, "objects": command.objects or None}
    if command.starts:
        settings["starts"] = command.starts
    return gym.make(f"pwm/{command.task}Sim-v0", max_episode_steps=most, camera=camera, **settings)


def _run_one(command: Plan, seed: int) -> Run:
    """One of the command's episodes."""
    from pwm_gym.planning import execute
    from pwm_gym.tasks import get_task

    most = command._most(get_task(command.task))
    return execute(_twin(command), _agent(command), seed, most, command.chunk, to_the_end=command.to_the_end)


def _release(command: Plan) -> None:
    """Close what this process ran episodes with."""
    if _twin.cache_info().currsize:
        _twin(command).close()
    _agent.cache_clear()
    _twin.cache_clear()


def print_success(title: str, table: dict[str, Any]) -> None:
    """Print a table of :func:`pwm_gym.evaluation.planning_table`."""
    low, high = table["interval"]
    latency, steps = table["plan_seconds"], table["mean_steps_of_successes"]
    print(f"\n{title}")
    print(f"  success          {table['successes']}/{table['episodes']}  (95 % interval {low:.0%} to {high:.0%})")
    if (held := table.get("successes_at_the_end")) is not None:
        print(f"  at the last step {held}/{table['episodes']}")
    print(f"  steps to success {steps:.1f} on average" if steps else "  steps to success -")
    print(f"  one action       {latency['median']:.2f} s median, {latency['p95']:.2f} s 95th percentile")
    for stage, count in table["stages"].items():
        print(f"  past {stage:27s} {count}/{table['episodes']}")
    if table["failed_seeds"]:
        print(f"  failed seeds     {', '.join(map(str, table['failed_seeds']))}")
