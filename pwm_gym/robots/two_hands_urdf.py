"""URDF of :mod:`pwm_gym.robots.two_hands`: two of ManiSkill's Pandas, each with a hand of boxes instead of its gripper.

Fingers' second joints have no mimic tag: the controller drives them by the rule, which PhysX's tags do not survive.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.robots.two_hands import SIDES, TWO_HANDS, Box, boxes
from pwm_gym.scene.joint import Joint, Pose7

__all__ = ["BASE", "urdf_file"]

BASE = "base"
"""Root link, amid both arms' bases: the frame of all public poses."""
_ARM_LINKS, _ARM_JOINTS = 9, 8  # of a Panda up to its flange, which is panda_link8
_DENSITY = 900.0  # kg per cubic metre, of a hand
_LEAST_INERTIA = 1e-5  # kg m^2: lighter links make stiff drives shake
_EFFORT, _SPEED = 20.0, 8.0  # Nm and rad/s that fingers may have


@contextmanager
def urdf_file() -> Iterator[Path]:
    """A file of the robot while it is read."""
    with tempfile.TemporaryDirectory(prefix="two-hands-") as folder:
        path = Path(folder) / "two_hands.urdf"
        path.write_bytes(ElementTree.tostring(_robot()))
        yield path


def _robot() -> Element:
    from mani_skill import PACKAGE_ASSET_DIR

    panda = Path(PACKAGE_ASSET_DIR) / "robots" / "panda" / "panda_v2.urdf"
    found = ElementTree.parse(panda).getroot()
    robot = Element("robot", name=TWO_HANDS.name)
    SubElement(robot, "link", name=BASE)
    for side in SIDES:
        _add_arm(robot, found, panda.parent, side)
        _add_hand(robot, side)
    return robot


def _add_arm(robot: Element, panda: Element, folder: Path, side: str) -> None:
    """A Panda up to its flange, its names behind the side's."""
    arm = next(a for a in TWO_HANDS.control.arms if a.name == side)
    assert arm.chain is not None
    x, y, _, *_ = arm.chain.origins[0]
    _add_joint(robot, f"{side}_mount", "fixed", BASE, f"{side}_panda_link0", (x, y, 0.0, 1.0, 0.0, 0.0, 0.0))
    for link in panda.findall("link")[:_ARM_LINKS]:
        own = deepcopy(link)
        own.set("name", f"{side}_{link.get('name')}")
        for mesh in own.iter("mesh"):
            mesh.set("filename", str(folder / mesh.get("filename", "")))
        robot.append(own)
    for joint in panda.findall("joint")[:_ARM_JOINTS]:
        own = deepcopy(joint)
        own.set("name", f"{side}_{joint.get('name')}")
        for tag in ("parent", "child"):
            end = own.find(tag)
            assert end is not None
            end.set("link", f"{side}_{end.get('link')}")
        robot.append(own)


def _add_hand(robot: Element, side: str) -> None:
    """The palm on the flange, and what hangs on it."""
    arm = next(a for a in TWO_HANDS.control.arms if a.name == side)
    assert arm.chain is not None
    palm = f"{side}_palm"
    _add_link(robot, palm)
    turn = (0.0, 0.0, 0.0, *arm.chain.mount[3:])  # the mount's way is that to panda_link8
    _add_joint(robot, f"{palm}_joint", "fixed", f"{side}_panda_link8", palm, turn)
    for name, joint in TWO_HANDS.joints.items():
        if name.startswith(side):
            assert joint.parent is not None
            _add_link(robot, name)
            _add_joint(robot, f"{name}_joint", joint.kind, joint.parent, name, joint.origin, joint)


def _add_link(robot: Element, name: str) -> None:
    """A link of boxes."""
    link = SubElement(robot, "link", name=name)
    for size, centre in boxes(name):
        for tag in ("visual", "collision"):
            shape = SubElement(link, tag)
            SubElement(shape, "origin", xyz=_text(centre), rpy="0 0 0")
            SubElement(SubElement(shape, "geometry"), "box", size=_text(size))
    _add_inertia(link, boxes(name)[0])


def _add_inertia(link: Element, box: Box) -> None:
    size, centre = (np.array(part) for part in box)
    mass = _DENSITY * float(size.prod())
    moments = np.maximum(mass / 12.0 * (np.square(size).sum() - np.square(size)), _LEAST_INERTIA)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_text(centre), rpy="0 0 0")
    SubElement(inertial, "mass", value=f"{mass:.6g}")
    crossed = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    own = {name: f"{moment:.6g}" for name, moment in zip(("ixx", "iyy", "izz"), moments, strict=True)}
    SubElement(inertial, "inertia", own | crossed)


def _add_joint(
    robot: Element, name: str, kind: str, parent: str, child: str, origin: Pose7, limits: Joint | None = None
) -> None:
    joint = SubElement(robot, "joint", name=name, type=kind)
    angles = Rotation.from_quat(origin[3:], scalar_first=True).as_euler("xyz")
    SubElement(joint, "origin", xyz=_text(origin[:3]), rpy=_text(angles))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    if limits is not None:
        SubElement(joint, "axis", xyz=_text(limits.axis))
        most = {"effort": f"{_EFFORT}", "velocity": f"{_SPEED}"}
        SubElement(joint, "limit", {"lower": f"{limits.lower}", "upper": f"{limits.upper}", **most})


def _text(values: object) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(values, np.float64))
