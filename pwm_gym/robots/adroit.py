"""The Adroit hand of Gymnasium-Robotics: 24 joints behind a forearm that its task lets slide and turn.

All actions are joint targets. The forearm's own joints are a gantry's; the fingers' links hang on it by the joints of
the model. The public frame is MuJoCo's world, the table's top at height 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from pwm_gym.robots.control import Arm, Channel, Control, Gantry
from pwm_gym.robots.gantry import GantryKinematics
from pwm_gym.robots.robot import Robot
from pwm_gym.scene import Layout, Support
from pwm_gym.scene.joint import Joint, Pose7
from pwm_gym.scene.poses import compose, rotation
from pwm_gym.scene.se3 import matrix_from_pose7

__all__ = [
    "DOOR_ARM",
    "DOOR_HAND",
    "GRASP",
    "PALM",
    "RELOCATE_ARM",
    "RELOCATE_HAND",
    "TABLE",
    "Forearm",
    "layout",
    "posture",
    "tool_pose",
]

_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_QUARTER = 1.571  # radians
_SPREAD = 0.436
_THUMB = (0.92388, 0.0, 0.38268, 0.0)  # a quarter of half a turn about y
_FINGERS = {  # metres from the palm's origin to the knuckles; the little finger's is on a metacarpal of its own
    "ff": ("palm", (0.033, 0.0, 0.095)),
    "mf": ("palm", (0.011, 0.0, 0.099)),
    "rf": ("palm", (-0.011, 0.0, 0.095)),
    "lf": ("lfmetacarpal", (-0.017, 0.0, 0.044)),
}
PALM = {
    "ffknuckle": (0.033, 0.0, 0.095),
    "mfknuckle": (0.011, 0.0, 0.099),
    "rfknuckle": (-0.011, 0.0, 0.095),
    "thbase": (0.034, -0.009, 0.029),
}
"""Links whose centres are fixed in the palm's frame, and where (3,), metres."""
GRASP = (0.007, -0.05, 0.07)
"""The place that grasps, before the palm, in its frame (the site S_grasp), metres."""
_START: Pose7 = (0.0, -0.7, 0.2, 0.000563, -0.000563, 0.706825, 0.707388)  # the forearm's, its joints at 0
_GAIN = 2.5  # of its position control: joints come to rest at so many times their targets
_PERIOD = 0.01  # seconds
TABLE = Support((0.0, 0.0, -0.025, 1.0, 0.0, 0.0, 0.0), (0.45, 0.45, 0.025))
"""The table, whose top is at height 0."""


def _at(place: tuple[float, float, float], turn: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> Pose7:
    x, y, z = place
    w, a, b, c = turn
    return (x, y, z, w, a, b, c)


def _hinge(
    parent: str,
    origin: Pose7,
    axis: tuple[float, float, float],
    lower: float,
    upper: float,
) -> Joint:
    return Joint("revolute", parent, origin, axis, lower, upper)


def _finger(name: str) -> dict[str, Joint]:
    """A finger's knuckle, which spreads, and its three links, which bend."""
    parent, place = _FINGERS[name]
    return {
        f"{name}knuckle": _hinge(parent, _at(place), _Y, -_SPREAD, _SPREAD),
        f"{name}proximal": _hinge(f"{name}knuckle", _at((0.0, 0.0, 0.0)), _X, 0.0, _QUARTER),
        f"{name}middle": _hinge(f"{name}proximal", _at((0.0, 0.0, 0.045)), _X, 0.0, _QUARTER),
        f"{name}distal": _hinge(f"{name}middle", _at((0.0, 0.0, 0.025)), _X, 0.0, _QUARTER),
    }


_JOINTS = {
    "wrist": _hinge("forearm", _at((0.0, 0.0, 0.396)), _Y, -0.524, 0.175),
    "palm": _hinge("wrist", _at((0.0, 0.0, 0.034)), _X, -0.785, 0.611),
    **_finger("ff"),
    **_finger("mf"),
    **_finger("rf"),
    "lfmetacarpal": _hinge("palm", _at((-0.017, 0.0, 0.044)), (0.571, 0.0, 0.821), 0.0, 0.698),
    **_finger("lf"),
    "thbase": _hinge("palm", _at(PALM["thbase"], _THUMB), (0.0, 0.0, -1.0), -1.047, 1.047),
    "thproximal": _hinge("thbase", _at((0.0, 0.0, 0.0)), _X, 0.0, 1.309),
    "thhub": _hinge("thproximal", _at((0.0, 0.0, 0.038)), _X, -0.262, 0.262),
    "thmiddle": _hinge("thhub", _at((0.0, 0.0, 0.0)), _Y, -0.524, 0.524),
    "thdistal": _hinge("thmiddle", _at((0.0, 0.0, 0.032)), _Y, -_QUARTER, 0.0),
}
_LINKS = {name: name for name in ("forearm", *_JOINTS)}
_ACTUATED = (  # names of the actuators of wrist and fingers, in order
    *("WRJ1", "WRJ0"),
    *(f"{finger}J{k}" for finger in ("FF", "MF", "RF") for k in (3, 2, 1, 0)),
    *(f"LFJ{k}" for k in (4, 3, 2, 1, 0)),
    *(f"THJ{k}" for k in (4, 3, 2, 1, 0)),
)


@dataclass(frozen=True)
class Forearm:
    """The joints that bring the forearm about: slides along its axes, then turns about them."""

    names: tuple[str, ...]
    slides: tuple[int, ...]
    """Axes (0 to 2) of the slides, in order; the turns are about all three, in order."""
    lower: tuple[float, ...]
    """Smallest target of each joint, metres and radians."""
    upper: tuple[float, ...]

    @cached_property
    def gantry(self) -> Gantry:
        """The same joints, as models know them."""
        return Gantry(_START, self.slides, self.lower, self.upper)

    @cached_property
    def _kinematics(self) -> GantryKinematics:
        return GantryKinematics(self.gantry)

    def joints(self, forearm: np.ndarray) -> np.ndarray:
        """Joint positions (K,) of the forearm at a pose (7,); turns are taken to be small."""
        return self._kinematics.solve(matrix_from_pose7(torch.from_numpy(forearm.astype(np.float64)))).numpy()

    def jacobian(self, forearm: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Way (3, K) of a place (3,) that the forearm carries, for each joint's metre or radian."""
        slides = rotation(np.array(_START)).as_matrix()[:, list(self.slides)]
        turns = np.cross(rotation(forearm).as_matrix().T, place - forearm[:3]).T
        return np.concatenate([slides, turns], 1)

    def targets(self, joints: np.ndarray) -> np.ndarray:
        """Components (K,) of an action that bring the joints to ``joints`` (K,)."""
        low, high = np.array(self.lower), np.array(self.upper)
        return np.clip((2.0 * joints / _GAIN - low - high) / (high - low), -1.0, 1.0)


DOOR_ARM = Forearm(("ARTz", "ARRx", "ARRy", "ARRz"), (2,), (-0.3, -0.75, -0.75, -1.0), (0.5, 0.75, 0.75, 2.0))
"""Ahead, and turns."""
RELOCATE_ARM = Forearm(
    ("ARTx", "ARTy", "ARTz", "ARRx", "ARRy", "ARRz"),
    (0, 1, 2),
    (-0.25, 0.0, -0.3, -0.75, -0.75, -0.75),
    (0.25, 0.2, 0.5, 0.75, 0.75, 0.75),
)
"""Anywhere, and turns."""


def tool_pose(poses: np.ndarray) -> np.ndarray:
    """Pose (7,) of the place that grasps before the palm, of entity poses (E, 7) whose third is the palm."""
    return compose(poses[2], np.array(_at(GRASP)))


def _robot(name: str, arm: Forearm) -> Robot:
    """The hand on a forearm."""
    own, size = len(arm.names), len(arm.names) + len(_ACTUATED)
    moved = own + 2  # the wrist's two joints move the whole hand, too
    channels = (
        Channel("joint", 0, own, rest=None, arm="arm"),
        Channel("joint", own, moved, rest=None),
        Channel("finger", moved, size, rest=None),
    )
    return Robot(
        name=name,
        links=_LINKS,
        control=Control(channels, (Arm("arm", "forearm", gantry=arm.gantry),), _PERIOD),
        joints=_JOINTS,
        tool=tool_pose,
        action_names=(*arm.names, *_ACTUATED),
    )


DOOR_HAND = _robot("adroit_door", DOOR_ARM)
"""Of the door's task (28 components)."""
RELOCATE_HAND = _robot("adroit_relocate", RELOCATE_ARM)
"""Of the ball's task (30 components)."""


def posture(arm: np.ndarray, wrist: np.ndarray, bend: float, thumb: Sequence[float] | None = None) -> np.ndarray:
    """Action (A,) that closes the fingers together.

    Args:
        arm: targets of the forearm's joints in [-1, 1].
        wrist: targets of the wrist's two joints in [-1, 1].
        bend: of the fingers, 0 straight to 1 bent by a right angle at each joint.
        thumb: targets of the thumb's first two joints in [-1, 1]; None bends them with the fingers.
    """
    shut = 2.0 * bend - 1.0
    finger = [0.0, shut, shut, shut]
    base, proximal = (bend, shut) if thumb is None else thumb
    targets = np.r_[arm, wrist, finger * 3, -1.0, finger, base, proximal, 0.0, 0.0, -shut]
    return np.clip(targets, -1.0, 1.0).astype(np.float32)


def layout(objects: Mapping[str, int], joints: Mapping[str, Joint], table: bool = True, points: int = 40) -> Layout:
    """The hand's 25 links with ``points`` points each, and objects (name -> points).

    Args:
        objects: loose where ``joints`` does not say otherwise.
        joints: object -> how it hangs on its parent.
        table: whether the table is near enough to be touched.
        points: of each link.
    """
    return Layout.build(
        [*((link, points) for link in _LINKS), *objects.items()],
        driven=tuple(_LINKS),
        joints={**_JOINTS, **joints},
        supports=[TABLE, Support.ground(-1.0)] if table else [Support.ground(-1.0)],
    )
