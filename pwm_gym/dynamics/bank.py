"""A checkpoint's initial scenes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.errors import CheckpointError
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.scene import SCHEMA, Layout, Scene

__all__ = ["SceneBank"]

_FORMAT = "pwm_gym.scenes"
_REQUIRED = ("clouds", "poses", "goals")
_FIELDS = (*_REQUIRED, "combination", "joints")


@dataclass(frozen=True)
class _Header:
    """What a bank's file says beside its arrays."""

    format: str
    schema: int
    task: str
    layout: Any
    assets: list[tuple[str, ...]]


@dataclass(frozen=True)
class SceneBank:
    """Initial scenes of one task, drawn from training seeds."""

    task: str
    layout: Layout
    clouds: np.ndarray
    """Canonical points (K, N, 3) of each combination of assets, float32."""
    poses: np.ndarray
    """(M, E, 7) float32."""
    goals: np.ndarray
    """(M, G) float32."""
    combination: np.ndarray
    """Place (M,) of each scene's assets in :attr:`clouds`."""
    assets: tuple[tuple[str, ...], ...] = ()
    """Names (K, E) of the combinations' assets, where a task's objects differ between episodes."""
    joints: np.ndarray | None = None
    """Joint positions (M, J) float32."""

    def __len__(self) -> int:
        return len(self.poses)

    def scene(self, index: int) -> Scene:
        """The scene at ``index``, at rest."""
        poses = np.repeat(self.poses[index].astype(np.float64)[None], 3, 0)
        joints = None if self.joints is None else np.stack([self.joints[index], np.zeros_like(self.joints[index])])
        place = int(self.combination[index])
        assets = self.assets[place] if self.assets else ()
        return Scene(self.task, self.layout, self.clouds[place], poses, self.goals[index], joints=joints, assets=assets)

    def save(self, path: Path) -> None:
        """Write the bank to an ``.npz`` file."""
        header = {
            "format": _FORMAT,
            "schema": SCHEMA,
            "task": self.task,
            "layout": self.layout.to_json(),
            "assets": self.assets,
        }
        save_arrays(path, {k: v for k in _FIELDS if (v := getattr(self, k)) is not None}, header)

    @classmethod
    def load(cls, path: Path) -> SceneBank:
        """Read a bank that :meth:`save` wrote.

        Raises:
            CheckpointError: truncated, foreign, of a newer schema, or arrays that do not fit each other.
        """
        arrays, header = load_arrays(path, "is truncated or not a scene bank", CheckpointError, _FORMAT, _Header)
        if header.schema > SCHEMA:
            raise CheckpointError(f"{path} has schema {header.schema}; this version reads up to {SCHEMA}")
        if missing := [name for name in (*_REQUIRED, "combination") if name not in arrays]:
            raise CheckpointError(f"{path} is not a scene bank (it lacks {', '.join(missing)})")
        try:
            layout = Layout.from_json(header.layout)
        except ValueError as error:
            raise CheckpointError(f"{path}: {error}") from error
        bank = cls(header.task, layout, assets=tuple(header.assets), **{k: arrays[k] for k in _FIELDS if k in arrays})
        bank._check(path)
        return bank

    def _check(self, path: Path) -> None:
        """Raise :class:`CheckpointError` where the arrays do not fit each other."""
        kinds, count = (len(a) if a.ndim else 0 for a in (self.clouds, self.poses))
        expected = {
            "clouds": (kinds, self.layout.points, 3),
            "poses": (count, len(self.layout), 7),
            "goals": (count, self.goals.shape[1] if self.goals.ndim > 1 else 0),
            "combination": (count,),
        }
        if self.joints is not None:
            expected["joints"] = (count, self.joints.shape[1] if self.joints.ndim > 1 else 0)
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise CheckpointError(f"{path}: {name} has shape {getattr(self, name).shape}; expected {shape}")
        if len(self.assets) not in (0, kinds):
            raise CheckpointError(f"{path} names assets of {len(self.assets)} combinations; expected {kinds}")
        for names in self.assets:
            if len(names) != len(self.layout):
                raise CheckpointError(
                    f"{path} names {len(names)} assets in a combination; expected {len(self.layout)}, one an entity"
                )
        whole = np.issubdtype(self.combination.dtype, np.integer)
        if not whole or (count and not 0 <= self.combination.min() <= self.combination.max() < kinds):
            raise CheckpointError(f"{path}: combination holds no places among {kinds} combinations of assets")
