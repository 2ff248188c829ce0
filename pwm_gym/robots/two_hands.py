"""Two Franka Emika Pandas side by side, each with a five-fingered hand of our own geometry.

A hand has six driven joints, two of the thumb and one of each finger; the second joint of a finger follows the first.
Its frame lies in the arm's flange: z to the finger tips, x out of the palm, y along the knuckles. Straight fingers
make a flat face at x = 0; their joints' limit keeps it flat when it presses on something. The two hands mirror each
other. Public poses are in the frame of the point between both arms' bases. Metres and radians.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.robots.cloud import RobotCloud
from pwm_gym.robots.control import Arm, Channel, Control, SerialArm
from pwm_gym.robots.panda import PANDA
from pwm_gym.robots.robot import Robot
from pwm_gym.scene import Layout, Support
from pwm_gym.scene.joint import Joint, Mimic, Pose7
from pwm_gym.scene.poses import compose

__all__ = [
    "AMID",
    "DRIVEN",
    "FACE",
    "FINGERS",
    "FLAT",
    "HELD",
    "HOLDING",
    "JOINT_NAMES",
    "REST",
    "SIDES",
    "SIGN",
    "TOOL",
    "TWO_HANDS",
    "action",
    "boxes",
    "finger_targets",
    "layout",
    "robot_cloud",
    "tool_pose",
]

SIDES = ("left", "right")
SIGN = {"left": 1.0, "right": -1.0}
"""Side -> which way along y it is from the middle; hands mirror each other."""
FINGERS = ("index", "middle", "ring", "little")
APART = 0.30
"""Distance of each arm's base from the point between them."""
FACE = 0.008
"""From the tool centre, out of the palm, to the face of straight fingers."""
TOOL = (-FACE, 0.0, 0.118)
"""Tool centre in the palm's frame: the middle of straight fingers."""
HELD = ((-0.012, 0.007), (-0.012, 0.005))
"""Gaps, from and to, of fingers and of the thumb to what they hold between them."""
AMID = (0.035, 0.06)
"""Of the tool beside the middle of such a thing, along the knuckles and in height, at most."""

_PALM_HEIGHT, _PALM_DEPTH, _PALM_HALF = 0.075, 0.026, 0.043
_RECESS = 0.004  # of the palm behind the fingers' face
_THICK, _WIDE, _SPACING = 2 * FACE, 0.019, 0.022  # of fingers
_PROXIMAL, _DISTAL = 0.044, 0.040
_BEND, _FOLLOW = 1.6, 0.8  # upper limit of a finger's joint, and how much the second one turns for each radian of it
_SWING, _FLEX = 1.9, 1.2  # upper limits of the thumb's joints
_THUMB_AXIS = (-0.016, 0.0, 0.058)  # it swings about z: 0 beside the palm, a right angle opposite to the fingers
_THUMB_ARM, _THUMB_LENGTH, _THUMB_THICK, _THUMB_WIDE = 0.100, 0.095, 0.016, 0.024
_POSITION_UNIT, _ROTATION_UNIT = 0.1, 0.1
_PERIOD = 0.05

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Sides and centre of a box in its link's frame."""


def _at(x: float, y: float, z: float, yaw: float = 0.0) -> Pose7:
    return (x, y, z, float(np.cos(0.5 * yaw)), 0.0, 0.0, float(np.sin(0.5 * yaw)))


def _hand_joints(side: str) -> dict[str, Joint]:
    """Link -> its joint, of all links of a hand but its palm; parents come first."""
    s, palm = SIGN[side], f"{side}_palm"
    thumb = f"{side}_thumb"
    joints = {
        f"{thumb}_1": Joint("revolute", palm, _at(*_THUMB_AXIS), (0.0, 0.0, -s), 0.0, _SWING),
        f"{thumb}_2": Joint("revolute", f"{thumb}_1", _at(0.0, s * _THUMB_ARM, 0.0), (s, 0.0, 0.0), 0.0, _FLEX),
    }
    for k, finger in enumerate(FINGERS):
        first, second = f"{side}_{finger}_1", f"{side}_{finger}_2"
        knuckle = _at(-0.5 * _THICK, s * (1.5 - k) * _SPACING, _PALM_HEIGHT)
        joints[first] = Joint("revolute", palm, knuckle, (0.0, 1.0, 0.0), 0.0, _BEND)
        follow = Mimic(first, _FOLLOW)
        middle = _at(0.0, 0.0, _PROXIMAL)
        joints[second] = Joint("revolute", first, middle, (0.0, 1.0, 0.0), 0.0, _FOLLOW * _BEND, follow)
    return joints


def boxes(link: str) -> tuple[Box, ...]:
    """The boxes that a link of a hand is made of."""
    side, part = link.split("_", 1)
    s = SIGN[side]
    if part == "palm":
        middle = (-_RECESS - 0.5 * _PALM_DEPTH, 0.0, 0.5 * _PALM_HEIGHT)
        return (((_PALM_DEPTH, 2 * _PALM_HALF, _PALM_HEIGHT), middle),)
    if part == "thumb_1":
        return (((_THUMB_THICK, _THUMB_ARM, _THUMB_THICK), (0.0, 0.5 * s * _THUMB_ARM, 0.0)),)
    if part == "thumb_2":
        return (((_THUMB_WIDE, _THUMB_THICK, _THUMB_LENGTH), (0.0, 0.0, 0.5 * _THUMB_LENGTH)),)
    length = _PROXIMAL if part.endswith("1") else _DISTAL
    return (((_THICK, _WIDE, length), (0.0, 0.0, 0.5 * length)),)


_JOINTS = {side: _hand_joints(side) for side in SIDES}
_LINKS = {name: name for side in SIDES for name in (f"{side}_palm", *_JOINTS[side])}
DRIVEN = {side: tuple(n for n, joint in _JOINTS[side].items() if joint.mimic is None) for side in SIDES}
"""Side -> links whose joints are driven, in the order of the action's finger targets: the thumb's two, then fingers."""


def _arm(side: str, first_joint: int) -> Arm:
    """A Panda whose palm faces the other one at rest."""
    panda = PANDA.control.arms[0].chain
    assert panda is not None
    s = SIGN[side]
    base = (0.0, s * APART, panda.origins[0][2], 1.0, 0.0, 0.0, 0.0)
    chain = SerialArm(
        origins=(base, *panda.origins[1:]),
        mount=_at(0.0, 0.0, 0.107, -0.25 * np.pi + 0.5 * s * np.pi),
        tool=TOOL,
        lower=panda.lower,
        upper=panda.upper,
        rest=panda.rest,
    )
    return Arm(side, f"{side}_palm", chain, first_joint)


def _channels(side: str, start: int) -> tuple[Channel, ...]:
    return (
        Channel("translation", start, start + 3, _POSITION_UNIT, arm=side),
        Channel("rotation", start + 3, start + 6, _ROTATION_UNIT, arm=side),
        Channel("finger", start + 6, start + 12, rest=None, arm=side),
    )


_ARM_JOINTS = len(PANDA.control.arms[0].chain.origins) if PANDA.control.arms[0].chain else 0
JOINT_NAMES = tuple(
    name
    for side in SIDES
    for name in (*(f"{side}_panda_joint{k + 1}" for k in range(_ARM_JOINTS)), *(f"{n}_joint" for n in _JOINTS[side]))
)
"""Of the robot's joint vector: an arm and its hand, then the other ones."""
_PER_SIDE = len(JOINT_NAMES) // len(SIDES)
_CONTROL = Control(
    channels=(*_channels("left", 0), *_channels("right", 12)),
    arms=(_arm("left", 0), _arm("right", _PER_SIDE)),
    period=_PERIOD,
)
REST = tuple(
    position for arm in _CONTROL.arms if arm.chain for position in (*arm.chain.rest, *[0.0] * len(_JOINTS["left"]))
)
"""Usual positions of all joints: hands flat and upright, their palms face each other."""


def robot_cloud() -> RobotCloud:
    """Clouds of all 22 links from 34 joint values, in the order of :data:`JOINT_NAMES`."""
    from pwm_gym.robots.two_hands_urdf import urdf_file

    points = {entity.name: entity.points for entity in layout({}) if entity.driven}
    with urdf_file() as path:
        return RobotCloud.from_urdf(path, _LINKS.values(), JOINT_NAMES, names=_LINKS, points=points)


def tool_pose(poses: np.ndarray, side: str) -> np.ndarray:
    """Tool centre pose (7,) of one hand, of entity poses (E, 7) that begin with the robot's links."""
    return compose(poses[TWO_HANDS.driven.index(f"{side}_palm")], np.array(_at(*TOOL)))


def finger_targets(thumb: tuple[float, float], bend: float) -> np.ndarray:
    """A hand's six targets in [-1, 1].

    Args:
        thumb: angles of its joints, radians.
        bend: angle of every finger's first joint, radians.
    """
    angles = np.array([*thumb, *[bend] * len(FINGERS)])
    upper = np.array([_SWING, _FLEX, *[_BEND] * len(FINGERS)])
    return np.clip(2.0 * angles / upper - 1.0, -1.0, 1.0)


FLAT = tuple(float(target) for target in finger_targets((0.0, 0.0), 0.0))
"""Targets (6,) of a hand with straight fingers, its thumb beside the palm."""
HOLDING = tuple(float(target) for target in finger_targets((0.5 * np.pi, 0.30), 0.0))
"""Targets (6,) of a hand that holds something between its thumb and straight fingers: a thumb that presses harder tips
it over."""


def action(moves: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> np.ndarray:
    """Action (24,) of both arms.

    Args:
        moves: side -> translation (3,) in metres, rotation vector (3,) in radians, finger targets (6,) in [-1, 1].

    Raises:
        PwmGymError: a side is missing.
    """
    if missing := [side for side in SIDES if side not in moves]:
        raise PwmGymError(f"no motion for the {missing[0]} arm; expected one for each of {', '.join(SIDES)}")
    parts = []
    for side in SIDES:
        translation, rotation, fingers = moves[side]
        parts += [translation / _POSITION_UNIT, rotation / _ROTATION_UNIT, fingers]
    return np.clip(np.concatenate(parts), -1.0, 1.0).astype(np.float32)


def _action_names(side: str) -> tuple[str, ...]:
    moves = ("dx", "dy", "dz", "rotation x", "rotation y", "rotation z", "thumb swing", "thumb", *FINGERS)
    return tuple(f"{side} {name}" for name in moves)


TWO_HANDS = Robot(
    name="two_hands",
    links=_LINKS,
    control=_CONTROL,
    joints={**_JOINTS["left"], **_JOINTS["right"]},
    cloud=robot_cloud,
    action_names=(*_action_names("left"), *_action_names("right")),
)


def layout(
    objects: Mapping[str, int],
    joints: Mapping[str, Joint] | None = None,
    palm: int = 400,
    link: int = 160,
) -> Layout:
    """Both hands' 22 links, and objects (name -> points) on the ground.

    Args:
        objects: loose where ``joints`` does not say otherwise.
        joints: object -> how it hangs on its parent.
        palm: points of each palm.
        link: points of each other link.
    """
    links = [(name, palm if name.endswith("palm") else link) for name in _LINKS]
    return Layout.build(
        [*links, *objects.items()],
        driven=TWO_HANDS.driven,
        joints={**TWO_HANDS.joints, **(joints or {})},
        supports=[Support.ground()],
    )
