"""``pwm-gym view``: a saved run as a picture, a GIF, a film or a page."""

from __future__ import annotations

from collections.abc import Iterator
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
    """Draw a run that ``pwm-gym plan --save`` wrote: predicted, real and both side by side.

    Without ``--html``, ``--gif`` or ``--mp4``, a picture (PNG) and a GIF.
    """

    run_file: tyro.conf.Positional[Path]
    """The run (.npz)."""
    out: Path = Path("view")
    """Folder of the pictures, which are named after the run."""
    html: Path | None = None
    """File for a page that plays the run in 3D, with charts along its time slider; it opens without a network (needs
    the extra "viewer")."""
    gif: Path | None = None
    """File for a GIF."""
    mp4: Path | None = None
    """File for a film."""
    fps: float = 12.0
    """Steps a second of what moves."""
    panel: int = 288
    """Side of each view of the GIF and the film, pixels."""
    rollout: bool = False
    """Whether to show one rollout from the first scene instead of what the planner predicted."""
    strip: bool = False
    """Whether to draw a strip, too: predicted over real at five instants."""
    checkpoint: str = "default"
    """Of that rollout: a folder or a shipped checkpoint's name."""

    def run(self) -> None:
        """Write what is asked for, and print the run's facts."""
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.errors import PwmGymError
        from pwm_gym.planning import Agent, Run

        run = Run.load(self.run_file)
        if not run.steps:
            raise PwmGymError(f"{self.run_file} holds no action: nothing happened that could be shown")
        shown = _LOOKS.get(run.chunk, f"the model looks every {run.chunk} steps")
        if self.rollout:
            task = run.start.task
            agent = Agent(load_checkpoint(resolve(self.checkpoint, task)).model, task)
            run, shown = rolled_out(run, agent), FROM_THE_FIRST
        print(f"seed {run.seed}: {'success' if run.success else 'failure'} after {run.steps} steps; {shown}")
        for path in self._write(twin_record(run, shown)):
            print(path)

    def _write(self, record: TwinRecord) -> Iterator[Path]:
        """Write every file that is asked for."""
        from pwm_gym.viewer import draw_overlays, write_gif, write_html, write_mp4, write_png

        stem = self.run_file.stem
        plain = self.html is None and self.gif is None and self.mp4 is None
        if plain:
            yield write_png(record, _ready(self.out / f"{stem}.png"))
        if self.strip:
            path = _ready(self.out / f"{stem}-strip.png")
            draw_overlays([record], record.title).save(path)
            yield path
        gif = self.out / f"{stem}.gif" if plain else self.gif
        if gif is not None:
            yield write_gif(record, _ready(gif), self.fps, panel=self.panel)
        if self.mp4 is not None:
            yield write_mp4(record, _ready(self.mp4), self.fps, self.panel)
        if self.html is not None:
            yield write_html(record, _ready(self.html), self.fps)


def _ready(path: Path) -> Path:
    """``path``, whose folder exists."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


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
        title=f"{start.task}: planned in the model, run in the simulator",
        subtitle=f"seed {run.seed}; {predicted}",
        stages=(run.stages[0], *run.stages) if run.stages else (),
    )


def _points(scene: Scene, poses: np.ndarray) -> np.ndarray:
    """World-frame points (T, N, 3) of entity poses (T, E, 7)."""
    from pwm_gym.scene import batch_state

    scenes = [replace(scene, poses=pose[None].repeat(3, 0)) for pose in poses]
    return batch_state(scenes).points().numpy()
