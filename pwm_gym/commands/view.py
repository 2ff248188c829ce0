"""``pwm-gym view``: a saved run as a picture and as a GIF."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

if TYPE_CHECKING:
    import numpy as np

    from pwm_gym.planning import Agent, Run
    from pwm_gym.scene import Scene
    from pwm_gym.viewer import TwinRecord

__all__ = ["FROM_THE_FIRST", "View", "rolled_out", "twin_record"]

FROM_THE_FIRST = "the model sees the first frame only, then the same actions"
"""What a picture says of :func:`rolled_out`."""
_LOOKS = {0: "planned from the first frame alone", 1: "the model looks at every step"}


@dataclass(frozen=True)
class View:
    """Draw a run that ``pwm-gym plan --save`` wrote: predicted, real and both side by side."""

    run_file: tyro.conf.Positional[Path]
    """The run (.npz)."""
    out: Path = Path("view")
    """Folder of the pictures, which are named after the run."""
    rollout: bool = False
    """Whether to show one rollout from the first scene instead of what the planner predicted."""
    strip: bool = False
    """Whether to draw a strip, too: predicted over real at five instants."""
    checkpoint: str = "default"
    """Of that rollout: a folder or a shipped checkpoint's name."""

    def run(self) -> None:
        """Write the PNG and the GIF, and print the run's facts."""
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.planning import Agent, Run
        from pwm_gym.viewer import draw_overlays, write_gif, write_png

        run = Run.load(self.run_file)
        shown = _LOOKS.get(run.chunk, f"the model looks every {run.chunk} steps")
        if self.rollout:
            task = run.start.task
            agent = Agent(load_checkpoint(resolve(self.checkpoint, task)).model, task)
            run, shown = rolled_out(run, agent), FROM_THE_FIRST
        record = twin_record(run, shown)
        self.out.mkdir(parents=True, exist_ok=True)
        print(f"seed {run.seed}: {'success' if run.success else 'failure'} after {run.steps} steps; {shown}")
        for suffix, write in ((".png", write_png), (".gif", write_gif)):
            print(write(record, self.out / f"{self.run_file.stem}{suffix}"))
        if self.strip:
            path = self.out / f"{self.run_file.stem}-strip.png"
            draw_overlays([record], record.title).save(path)
            print(path)


def rolled_out(run: Run, agent: Agent) -> Run:
    """The same run, with what an agent's model predicts of all its actions from the first scene alone.

    Raises:
        UnknownNameError: the run's rewards are of a cost that is not registered, so that no others can be told.
    """
    import torch

    from pwm_gym.costs import COSTS, get_cost
    from pwm_gym.dynamics import rollout
    from pwm_gym.errors import UnknownNameError
    from pwm_gym.scene import batch_state
    from pwm_gym.scene.se3 import pose7_from_matrix

    start = run.shown or run.start
    name = run.settings.get("reward_cost", agent.task.cost)
    if name not in COSTS:
        known = ", ".join(sorted(COSTS))
        raise UnknownNameError(
            f"unknown cost {name!r}, of which the run's rewards are; register it to roll the run out; known: {known}"
        )
    cost = get_cost(name)
    agent.look(start)
    with torch.no_grad():
        states = rollout(agent.model, batch_state([start]), torch.as_tensor(run.actions)[None])[0]
    return replace(
        run,
        predicted=pose7_from_matrix(states.poses().double()).numpy(),
        predicted_rewards=agent.rewards(states, run.actions, cost),
        terms={},
        predicted_terms={},  # the run's planner may have had other terms than the task's cost
    )


def twin_record(run: Run, predicted: str) -> TwinRecord:
    """Both worlds of a run, ready to be drawn; ``predicted`` says what the prediction is of."""
    import numpy as np

    from pwm_gym.evaluation import chamfer
    from pwm_gym.viewer import TwinRecord

    start, shown = run.start, run.shown or run.start
    told = _points(shown, np.concatenate([shown.poses[:1], run.predicted]))
    true = _points(start, run.poses)
    return TwinRecord(
        predicted=told,
        true=true,
        layout=start.layout,
        error=np.array([chamfer(p, q) for p, q in zip(told, true, strict=True)]),
        goal=start.goal if len(start.goal) == 3 else None,  # a place, where the task has one
        predicted_reward=np.array([run.predicted_rewards[0], *run.predicted_rewards]),
        true_reward=np.array([run.rewards[0], *run.rewards]),
        title=f"{start.task}: planned in the world model, executed in the simulator",
        subtitle=f"seed {run.seed}; {predicted}",
        stages=(run.stages[0], *run.stages) if run.stages else (),
    )


def _points(scene: Scene, poses: np.ndarray) -> np.ndarray:
    """World-frame points (T, N, 3) of entity poses (T, E, 7)."""
    from pwm_gym.scene import batch_state

    scenes = [replace(scene, poses=pose[None].repeat(3, 0)) for pose in poses]
    return batch_state(scenes).points().numpy()
