"""Plain descriptions of an arm and of what the components of an action mean; a checkpoint stores them as JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Control", "SerialArm"]

Pose7 = tuple[float, ...]


@dataclass(frozen=True)
class SerialArm:
    """Revolute joints in a row, and the controller that moves the tool at their end.

    The controller takes an action's first six components as a change of the tool's present pose in the base's frame,
    solves inverse kinematics for it and drives the joints there; where there is no solution the joints stay.
    """

    origins: tuple[Pose7, ...]
    """Pose (7,) of each joint's frame in the link before it, at angle 0; the joint turns about its z axis."""
    mount: Pose7
    """Pose (7,) of the end effector's root link in the last joint's frame."""
    tool: tuple[float, float, float]
    """Tool centre in the root link's frame, metres."""
    lower: tuple[float, ...]
    """Joint limits, radians."""
    upper: tuple[float, ...]
    rest: tuple[float, ...]
    """Usual joint angles: where inverse kinematics begins when a scene does not tell them."""
    position_unit: float
    """Metres per unit of translation."""
    rotation_unit: float
    """Radians per unit of rotation, about x, then y, then z; the norm of the three units is clipped to 1."""

    @property
    def joints(self) -> int:
        """How many joints it has."""
        return len(self.origins)


@dataclass(frozen=True)
class Control:
    """What an action's components mean."""

    vectors: tuple[tuple[int, int], ...] = ()
    """Half-open ranges of three components each that are vectors in the base's frame, so that a model can turn them."""
    arm: SerialArm | None = None
    """The arm behind the first six components, where it is known."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"vectors": [list(v) for v in self.vectors], "arm": None if self.arm is None else asdict(self.arm)}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Control:
        """What :meth:`to_json` gave."""
        arm = values["arm"]
        vectors = tuple((int(a), int(b)) for a, b in values["vectors"])
        return cls(vectors, None if arm is None else SerialArm(**{k: _tuples(v) for k, v in arm.items()}))


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
