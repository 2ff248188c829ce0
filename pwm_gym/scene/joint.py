"""How an entity hangs on its parent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from pwm_gym.errors import SceneError

__all__ = ["FIXED", "FREE", "IDENTITY", "JOINT_KINDS", "Joint", "JointKind", "Mimic", "Pose7"]

JointKind = Literal["free", "fixed", "prismatic", "revolute"]
JOINT_KINDS: tuple[JointKind, ...] = ("free", "fixed", "prismatic", "revolute")
"""Kinds of joints, in the order in which features name them."""

Pose7 = tuple[float, float, float, float, float, float, float]
"""xyz in metres, unit quaternion wxyz."""
IDENTITY: Pose7 = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_UNIT = 1e-3  # by which the norm of an axis or a quaternion may differ from 1


@dataclass(frozen=True)
class Mimic:
    """Rule by which a joint follows another: ``position = multiplier * other + offset``."""

    entity: str
    """Entity whose joint is followed."""
    multiplier: float = 1.0
    offset: float = 0.0
    """Radians, or metres for a prismatic joint."""

    def __post_init__(self) -> None:
        """Whole numbers are as good as others."""
        for name in ("multiplier", "offset"):
            object.__setattr__(self, name, float(getattr(self, name)))


@dataclass(frozen=True)
class Joint:
    """Joint between an entity and its parent.

    At position q the entity's frame in its parent's is ``origin`` times a turn by q radians about ``axis``
    (revolute) or a shift by q metres along it (prismatic).

    Raises:
        SceneError: an unknown kind, limits upside down, an axis or a quaternion that is not of unit length.
    """

    kind: JointKind = "free"
    parent: str | None = None
    """Entity that carries this one; None is the world (the base's frame)."""
    origin: Pose7 = IDENTITY
    """The entity's pose in the parent's frame at position 0."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector in the entity's own frame."""
    lower: float = 0.0
    """Smallest position: radians, or metres for a prismatic joint."""
    upper: float = 0.0
    """Largest position."""
    mimic: Mimic | None = None
    """The joint that this one follows, if any."""

    def __post_init__(self) -> None:
        """Check what can be checked without the other entities; whole numbers are as good as others."""
        for name in ("lower", "upper"):
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in ("origin", "axis"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        if self.kind not in JOINT_KINDS:
            raise SceneError(f"joint kind {self.kind!r}; expected one of {', '.join(JOINT_KINDS)}")
        if self.kind == "free" and self.parent is not None:
            raise SceneError(f"a free joint has no parent; got {self.parent!r}")
        if not all(map(math.isfinite, (*self.origin, *self.axis, self.lower, self.upper))):
            raise SceneError(f"joint {self.kind} has values that are not finite")
        if self.moves and not self.lower <= self.upper:
            raise SceneError(f"joint limits {self.lower} to {self.upper}; expected the lower one first")
        if self.moves and abs(math.hypot(*self.axis) - 1.0) > _UNIT:
            raise SceneError(f"joint axis {self.axis} has length {math.hypot(*self.axis):.3f}; expected 1")
        if abs(math.hypot(*self.origin[3:]) - 1.0) > _UNIT:
            raise SceneError(f"joint origin {self.origin} has a quaternion that is not of unit length")

    @property
    def moves(self) -> bool:
        """Whether it has one degree of freedom."""
        return self.kind in ("prismatic", "revolute")


FREE = Joint()
"""Not attached to anything."""
FIXED = Joint("fixed")
"""Fixed to the world where it is."""
