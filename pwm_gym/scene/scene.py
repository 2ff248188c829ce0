"""A scene: all that starts an episode, in the model or in the simulator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pwm_gym.errors import SceneError
from pwm_gym.files import load_arrays, save_arrays
from pwm_gym.scene.cloud import resample_clouds
from pwm_gym.scene.layout import Layout
from pwm_gym.scene.positions import joint_positions, within_limits
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.scene.state import RigidState

__all__ = ["SCHEMA", "Scene", "batch_state"]

SCHEMA = 2
"""Of scenes, data sets and checkpoints; files of schema 1 (version 0.1) are read, too."""
_FORMAT = "pwm_gym.scene"
_REQUIRED = ("clouds", "poses", "goal")
_SEEN = (0.25, 0.01)
"""By which a part may seem beyond its limits (a camera sees it badly, or MuJoCo's soft limits give way): share of its
range; metres or radians."""
_FIELDS = (*_REQUIRED, "joints", "last_action")


@dataclass(frozen=True)
class _Header:
    """What a scene's file says beside its arrays."""

    format: str
    schema: int
    task: str
    layout: Any
    assets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scene:
    """Entities' canonical clouds and poses, and the goal. Everything is in the robot base's frame.

    Its last three poses carry the velocities; a static scene repeats one pose.
    """

    task: str
    layout: Layout
    clouds: np.ndarray
    """Canonical points (N, 3), float32, metres."""
    poses: np.ndarray
    """Entity poses (3, E, 7) at t, t-1, t-2: xyz in metres, unit quaternion wxyz."""
    goal: np.ndarray
    """(G,) as the task defines it; for PickCube the cube's goal position in metres."""
    joints: np.ndarray | None = None
    """Robot joint positions and velocities (2, J), when they are known: radians (sliding joints: metres), and these a
    control step. Some models and a simulator start from them."""
    last_action: np.ndarray | None = None
    """The action (A,) that led here, if any: it tells whether the gripper was commanded shut."""
    assets: tuple[str, ...] = ()
    """Name of each entity's asset (E,), where a task's objects differ between episodes; a simulator starts from it."""

    def validate(self, task: str, layout: Layout, goal_size: int, extra: bool = False) -> Scene:
        """This scene, checked against what ``task`` expects.

        Args:
            task: the task's name.
            layout: its entities, and the points that each has at least.
            goal_size: G.
            extra: whether further free entities (clutter) may follow the task's.

        Raises:
            SceneError: naming the first thing that does not fit.
        """
        if self.task != task:
            raise SceneError(f"the scene is of task {self.task!r}; expected {task!r}")
        further = self.layout.entities[len(layout) :] if extra else ()
        names = (*layout.names, *(e.name for e in further))
        if self.layout.names != names:
            raise SceneError(f"the scene's entities are {self.layout.names}; expected {layout.names}")
        if bound := [e.name for e in further if not e.loose]:
            raise SceneError(f"the scene's further entities {', '.join(bound)} are not free; expected free ones alone")
        counts, wanted = ([e.points for e in x.entities[: len(layout)]] for x in (self.layout, layout))
        if self.assets and len(self.assets) != len(names):
            raise SceneError(
                f"the scene names {len(self.assets)} assets; expected one for each of {len(names)} entities"
            )
        if any(c < w for c, w in zip(counts, wanted, strict=True)):
            raise SceneError(f"the scene's point counts are {counts}; expected at least {wanted}")
        shapes: dict[str, tuple[int, ...]] = {
            "clouds": (self.layout.points, 3),
            "poses": (3, len(names), 7),
            "goal": (goal_size,),
        }
        if self.joints is not None:
            shapes["joints"] = (2, np.size(self.joints) // 2)
        for name, shape in shapes.items():
            array = getattr(self, name)
            if not isinstance(array, np.ndarray):
                raise SceneError(f"scene.{name} is a {type(array).__name__}; expected an array of shape {shape}")
            if array.shape != shape:
                raise SceneError(f"scene.{name} has shape {array.shape}; expected {shape}")
            if array.dtype.kind not in "fiu":
                raise SceneError(f"scene.{name} has type {array.dtype}; expected numbers")
            if not np.isfinite(array).all():
                raise SceneError(f"scene.{name} holds {int((~np.isfinite(array)).sum())} values that are not finite")
        norms = np.linalg.norm(self.poses[..., 3:], axis=-1)
        if np.abs(norms - 1).max() > 1e-2:
            raise SceneError(f"scene.poses has a quaternion of norm {norms.flat[np.abs(norms - 1).argmax()]:.3f}")
        self._check_joints()
        return self

    def _check_joints(self) -> None:
        """Refuse parts that are beyond their joint's limits; a robot's own links may be anywhere."""
        parts = [i for i, entity in enumerate(self.layout) if entity.joint.moves and not entity.driven]
        poses = matrix_from_pose7(torch.tensor(self.poses[0], dtype=torch.float64)) if parts else torch.empty(0)
        for i in parts:
            name, joint = self.layout.entities[i].name, self.layout.entities[i].joint
            if joint.kind == "revolute" and not -np.pi < joint.lower <= joint.upper < np.pi:
                continue  # a pose tells turns of up to half a one to either side
            position = float(joint_positions(self.layout, poses, i))
            within_limits(f"the joint of {name!r}", position, joint.lower, joint.upper, *_SEEN)

    def coarsen(self, layout: Layout) -> Scene:
        """The same scene with the (fewer) points of ``layout``."""
        if layout == self.layout:
            return self
        return replace(self, layout=layout, clouds=resample_clouds(self.clouds, self.layout, layout))

    def save(self, path: str | Path) -> None:
        """Write the scene to an ``.npz`` file (arrays and JSON text, no pickle)."""
        arrays = {k: v for k in _FIELDS if (v := getattr(self, k)) is not None}
        header = {
            "format": _FORMAT,
            "schema": SCHEMA,
            "task": self.task,
            "layout": self.layout.to_json(),
            "assets": self.assets,
        }
        save_arrays(path, arrays, header)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene that :meth:`save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            SceneError: the file is truncated or not a scene.
        """
        if not Path(path).exists():
            raise FileNotFoundError(f"{path} does not exist; expected a scene file")
        found, header = load_arrays(path, "is not a scene file", SceneError, _FORMAT, _Header)
        if header.schema > SCHEMA:
            raise SceneError(f"{path} has schema {header.schema}; this version reads up to {SCHEMA}")
        arrays = {k: found[k] for k in _FIELDS if k in found}
        if missing := [k for k in _REQUIRED if k not in arrays]:
            raise SceneError(f"{path} is not a scene file (it lacks {', '.join(missing)})")
        return cls(task=header.task, layout=Layout.from_json(header.layout), assets=header.assets, **arrays)


def batch_state(scenes: list[Scene], device: torch.device | str = "cpu") -> RigidState:
    """State (B,) of scenes that share one layout; with joints where all of them have some."""
    clouds = torch.as_tensor(np.stack([s.clouds for s in scenes]), dtype=torch.float32)
    poses = torch.as_tensor(np.stack([s.poses for s in scenes]), dtype=torch.float64)
    frames = matrix_from_pose7(poses).float()  # (B, 3, E, 4, 4)
    known = [s.joints for s in scenes if s.joints is not None]
    joints = None
    if len(known) == len(scenes):
        joints = torch.as_tensor(np.stack(known), dtype=torch.float32, device=device)
    return RigidState(scenes[0].layout, clouds.to(device), frames.to(device), joints)
