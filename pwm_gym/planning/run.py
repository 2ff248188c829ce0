"""What happened in one planned episode: a record that saves to a file and loads from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.costs import STAGES_LEFT
from pwm_gym.errors import PwmGymError
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.scene import SCHEMA, Scene
from pwm_gym.scene.layout import Layout

__all__ = ["Run"]

_FORMAT = "pwm_gym.run"
_FACTS = ("seed", "chunk", "success", "at_reset")
_ARRAYS = ("actions", "rewards", "plan_seconds", "poses", "predicted", "predicted_rewards")
_START, _SHOWN = "start.", "shown."


@dataclass(frozen=True)
class _Header:
    """What a run's file says beside its arrays."""

    format: str
    schema: int
    task: str
    layout: Any
    seed: int
    chunk: int
    success: bool
    at_reset: bool
    settings: dict[str, Any]
    terms: list[str]
    shown_layout: Any = None
    assets: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Run:
    """One episode of T actions. Metres, base frame.

    Raises:
        PwmGymError: arrays that do not fit each other.
    """

    start: Scene
    """The first scene."""
    seed: int
    """Of the episode and of the planner's noise."""
    success: bool
    """Whether the environment called any step a success."""
    actions: np.ndarray
    """(T, A) in [-1, 1]."""
    rewards: np.ndarray
    """The environment's (T,)."""
    plan_seconds: np.ndarray
    """Seconds (T,) from looking to the action."""
    poses: np.ndarray
    """Real entity poses (T + 1, E, 7): xyz in metres, unit quaternion wxyz."""
    predicted: np.ndarray
    """Poses (T, E, 7) that the model predicted after each action, since it last looked."""
    predicted_rewards: np.ndarray
    """Rewards (T,) of the predicted states, by the environment's own cost."""
    terms: dict[str, np.ndarray] = field(default_factory=dict)
    """The planner's cost of the real states after each action, term -> (T,)."""
    predicted_terms: dict[str, np.ndarray] = field(default_factory=dict)
    """The same of the predicted states."""
    chunk: int = 1
    """Actions between two looks; 0 where it looked once."""
    at_reset: bool = False
    """Whether it was a success before the first action; such seeds are left out of tables."""
    settings: dict[str, Any] = field(default_factory=dict)
    """What planned: model, planner and cost; ``reward_cost`` names the cost that the rewards are of."""
    shown: Scene | None = None
    """The first scene as it was shown, where its clouds are not the real ones; ``predicted`` moves those."""
    solved: np.ndarray | None = None
    """Whether the environment called each step (T,) a success; None in records of earlier versions, which end there."""

    def __post_init__(self) -> None:
        """Check the arrays' lengths."""
        if np.ndim(self.actions) != 2:
            raise PwmGymError(f"run.actions has shape {np.shape(self.actions)}; expected (T, A)")
        steps, entities = len(self.actions), len(self.start.layout)
        shapes = {
            "rewards": (steps,),
            "plan_seconds": (steps,),
            "poses": (steps + 1, entities, 7),
            "predicted": (steps, entities, 7),
            "predicted_rewards": (steps,),
        }
        if self.solved is not None:
            shapes["solved"] = (steps,)
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise PwmGymError(f"run.{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        if self.terms.keys() != self.predicted_terms.keys():
            told = ", ".join(sorted(self.terms.keys() ^ self.predicted_terms.keys()))
            raise PwmGymError(f"run has cost term {told} of real or of predicted states alone")
        for name, values in (*self.terms.items(), *self.predicted_terms.items()):
            if np.shape(values) != (steps,):
                raise PwmGymError(f"run's cost term {name!r} has shape {np.shape(values)}; expected {(steps,)}")

    @property
    def steps(self) -> int:
        """Actions executed, T."""
        return len(self.actions)

    @property
    def steps_to_success(self) -> int | None:
        """Actions until the first success; None without any."""
        if not self.success:
            return None
        return self.steps if self.solved is None else int(np.argmax(self.solved)) + 1

    @property
    def holds(self) -> bool:
        """Whether the last step is a success: one may be passed through."""
        return self.success if self.solved is None else bool(self.solved[-1])

    @property
    def stages(self) -> tuple[str, ...]:
        """Name of the stage (T,) after each action, where the planner's cost is a sequence of stages; empty elsewhere.

        The last name stands for what follows the last stage.
        """
        names, left = self.settings.get("stages"), self.terms.get(STAGES_LEFT)
        if not names or left is None:
            return ()
        done = len(names) - 1 - np.round(left / self.settings["stage_price"]).astype(int)
        return tuple(names[k] for k in done)

    def save(self, path: str | Path) -> None:
        """Write the record to an ``.npz`` file (arrays and JSON text, no pickle)."""
        scenes = {_START: self.start, **({} if self.shown is None else {_SHOWN: self.shown})}
        parts = {
            f"{prefix}{k}": v for prefix, scene in scenes.items() for k, v in asdict(scene).items() if _is_array(v)
        }
        header = {
            "format": _FORMAT,
            "schema": SCHEMA,
            "task": self.start.task,
            "assets": self.start.assets,
            "layout": self.start.layout.to_json(),
            "shown_layout": None if self.shown is None else self.shown.layout.to_json(),
            "seed": int(self.seed),
            "chunk": int(self.chunk),
            "success": bool(self.success),
            "at_reset": bool(self.at_reset),
            "settings": self.settings,
            "terms": list(self.terms),
        }
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _ARRAYS}
        both = [source[name] for source in (self.terms, self.predicted_terms) for name in self.terms]
        arrays["terms"] = np.stack(both) if both else np.empty(0)
        if self.solved is not None:
            arrays["solved"] = self.solved
        save_arrays(path, {**arrays, **parts}, header)

    @classmethod
    def load(cls, path: str | Path) -> Run:
        """Read a record that :meth:`save` wrote.

        Raises:
            PwmGymError: the file is missing, truncated or not a run.
        """
        complaint = "is not a run's file"
        found, header = load_arrays(path, complaint, PwmGymError, _FORMAT, _Header)
        if header.schema > SCHEMA:
            raise PwmGymError(f"{path} has schema {header.schema}; this version reads up to {SCHEMA}")
        if missing := [name for name in (*_ARRAYS, "terms") if name not in found]:
            raise PwmGymError(f"{path} {complaint} (it lacks {', '.join(missing)})")
        values, names = found["terms"], header.terms
        if names and values.shape[:1] != (2 * len(names),):
            raise PwmGymError(f"{path} has terms of shape {values.shape}; expected {2 * len(names)} rows")
        arrays: dict[str, Any] = {name: found[name] for name in _ARRAYS}
        shown = None if header.shown_layout is None else _scene(header, header.shown_layout, found, _SHOWN)
        return cls(
            start=_scene(header, header.layout, found, _START),
            shown=shown,
            solved=found.get("solved"),
            settings=header.settings,
            terms=dict(zip(names, values, strict=False)),
            predicted_terms=dict(zip(names, values[len(names) :], strict=False)),
            **{name: getattr(header, name) for name in _FACTS},
            **arrays,
        )


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)


def _scene(header: _Header, layout: Any, arrays: dict[str, np.ndarray], prefix: str) -> Scene:
    """The scene whose arrays have names that begin with ``prefix``."""
    own: dict[str, Any] = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
    known = {f.name for f in fields(Scene)}
    if not {"clouds", "poses", "goal"} <= own.keys() <= known:
        raise PwmGymError(f"a run's scene has arrays {', '.join(sorted(own))}; expected clouds, poses and goal")
    return Scene(task=header.task, layout=Layout.from_json(layout), assets=header.assets, **own)
