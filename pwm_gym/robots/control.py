"""What the components of an action mean, and the arms that they move; a checkpoint stores it as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal

from pwm_gym.errors import CheckpointError, PwmGymError, unknown_name
from pwm_gym.scene.joint import Pose7
from pwm_gym.schema import convert

__all__ = ["Arm", "Channel", "ChannelKind", "Control", "Gantry", "SerialArm"]

ChannelKind = Literal["translation", "rotation", "yaw", "gripper", "finger", "joint"]
_VECTORS = ("translation", "rotation")


@dataclass(frozen=True)
class SerialArm:
    """Revolute joints in a row, with the hand at their end.

    Its controller takes a change of the tool's present pose in the base's frame, solves inverse kinematics for it and
    drives the joints there; where there is no solution the joints stay.

    Raises:
        PwmGymError: it has no joint, or limits or a rest of another number.
    """

    origins: tuple[Pose7, ...]
    """Pose (7,) of each joint's frame in the link before it, at angle 0; the joint turns about its z axis. The first
    one is in the frame of all public poses, so that a second arm's base stands in its first origin."""
    mount: Pose7
    """Pose (7,) of the hand in the last joint's frame."""
    tool: tuple[float, float, float]
    """Tool centre in the hand's frame, metres."""
    lower: tuple[float, ...]
    """Joint limits, radians."""
    upper: tuple[float, ...]
    rest: tuple[float, ...]
    """Usual joint angles: where inverse kinematics begins when a scene does not tell them."""
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """Lowest and highest corner of the box in which the controller keeps the tool centre's targets, metres."""

    def __post_init__(self) -> None:
        """Check that each joint has limits and a rest."""
        counts = [len(self.origins), len(self.lower), len(self.upper), len(self.rest)]
        if counts != [counts[0]] * 4 or not counts[0]:
            raise PwmGymError(f"an arm has {counts} origins, lower limits, upper limits and rests; expected as many")

    @property
    def joints(self) -> int:
        """How many joints it has."""
        return len(self.origins)


@dataclass(frozen=True)
class Gantry:
    """Slides along axes of a fixed frame, then turns about its x, y and z axes, in this order, the hand at the end.

    Its controller drives each joint to a target of its own.

    Raises:
        PwmGymError: an axis that is none, twice the same, or limits of another number of joints.
    """

    origin: Pose7
    """Pose (7,) of the hand with all joints at 0, in the frame of all public poses; joints are about its axes."""
    slides: tuple[int, ...]
    """Axes (0 to 2) of the slides, in order."""
    lower: tuple[float, ...]
    """Joint limits, metres and radians; springs, so that targets near them are overshot."""
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check axes and limits."""
        if not {*self.slides} <= {0, 1, 2} or len({*self.slides}) < len(self.slides):
            raise PwmGymError(f"slides={self.slides}; expected different axes from 0 to 2")
        if len(self.lower) != self.joints or len(self.upper) != self.joints:
            raise PwmGymError(
                f"a gantry of {self.joints} joints has {len(self.lower)} lower and {len(self.upper)} upper limits"
            )

    @property
    def joints(self) -> int:
        """How many joints it has."""
        return len(self.slides) + 3


@dataclass(frozen=True)
class Channel:
    """Components ``start:stop`` of an action that mean one thing."""

    kind: ChannelKind
    """"translation" and "rotation" change the tool's pose (three components, in the base's frame); "yaw" turns a tool
    that the controller keeps pointing down (one component); a "gripper" opens (1) and shuts (-1); "finger" and "joint"
    components are targets of single joints."""
    start: int
    stop: int
    unit: float = 1.0
    """Metres (radians) per unit; negative where the controller turns the other way."""
    rest: float | None = 0.0
    """Value that asks for nothing; None where it is the last value (absolute targets)."""
    arm: str = ""
    """Arm that it belongs to, if any."""

    @property
    def slice(self) -> slice:
        """Its place in an action."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class Arm:
    """An arm with its hand."""

    name: str
    hand: str
    """Entity at its end: a driven one without a parent."""
    chain: SerialArm | None = None
    """Its joints, where they are known; otherwise the hand's response is fitted."""
    first_joint: int = 0
    """Where its joints begin in the robot's joint vector."""
    gantry: Gantry | None = None
    """The same of an arm that is a gantry."""

    def __post_init__(self) -> None:
        """Check that its joints are told once."""
        if self.chain is not None and self.gantry is not None:
            raise PwmGymError(f"arm {self.name!r} has a chain and a gantry; expected one of them")

    @property
    def joints(self) -> slice:
        """Its joints' place in the robot's joint vector."""
        known = self.chain or self.gantry
        return slice(self.first_joint, self.first_joint + (known.joints if known else 0))


@dataclass(frozen=True)
class Control:
    """Meaning of an action: its channels in order, and the arms that they move.

    Raises:
        PwmGymError: components that no channel or two channels take, a vector that has not three components, two of
            one kind for one arm, a channel of an unknown arm, arms that share a name, a hand or joints.

    Example:
        >>> control = Control((Channel("translation", 0, 3, unit=0.1), Channel("gripper", 3, 4, rest=1.0)))
        >>> control.size, control.rest()
        (4, (0.0, 0.0, 0.0, 1.0))
    """

    channels: tuple[Channel, ...] = ()
    arms: tuple[Arm, ...] = ()
    period: float = 0.05
    """Seconds per control step."""

    def __post_init__(self) -> None:
        """Check that channels and arms fit each other."""
        self._check_arms()
        end = 0
        for channel in self.channels:
            count = channel.stop - channel.start
            if channel.start != end or count < 1:
                raise PwmGymError(
                    f"channel {channel.kind!r} takes components {channel.start} to {channel.stop} of the action; "
                    f"expected them to begin at {end}"
                )
            wanted = 3 if channel.kind in _VECTORS else 1 if channel.kind == "yaw" else count
            if count != wanted:
                raise PwmGymError(f"channel {channel.kind!r} has {count} components; expected {wanted}")
            if channel.arm and channel.arm not in self.arm_names:
                raise unknown_name("arm", channel.arm, self.arm_names)
            if channel.kind in _VECTORS and channel is not self.channel(channel.arm, channel.kind):
                told = f"arm {channel.arm!r}" if channel.arm else "no arm"
                raise PwmGymError(f"two channels {channel.kind!r} of {told}; expected one")
            end = channel.stop

    def _check_arms(self) -> None:
        taken: set[int] = set()
        for what in ("name", "hand"):
            values = [getattr(arm, what) for arm in self.arms]
            if len({*values}) < len(values):
                raise PwmGymError(f"two arms have the same {what}: {', '.join(values)}")
        for arm in self.arms:
            if arm.first_joint < 0:
                raise PwmGymError(f"arm {arm.name!r} has joints from {arm.first_joint}; expected 0 or more")
            joints = {*range(arm.joints.start, arm.joints.stop)}
            if joints & taken:
                raise PwmGymError(f"arm {arm.name!r} shares joints {sorted(joints & taken)} with another arm")
            taken |= joints
        if not self.period > 0.0:
            raise PwmGymError(f"period={self.period}; expected more than 0 seconds")

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms, in order."""
        return tuple(arm.name for arm in self.arms)

    @property
    def size(self) -> int:
        """Number A of an action's components."""
        return self.channels[-1].stop if self.channels else 0

    @cached_property
    def kinds(self) -> tuple[ChannelKind, ...]:
        """Kind of each component (A,)."""
        return tuple(c.kind for c in self.channels for _ in range(c.start, c.stop))

    @property
    def drives_to_targets(self) -> bool:
        """Whether actions tell joints that move links where to be, rather than how to move."""
        return any(c.rest is None for c in self.of_kind("joint"))

    def rest(self) -> tuple[float, ...]:
        """Action (A,) that asks for nothing; 0 where that depends on the last action."""
        return tuple(c.rest or 0.0 for c in self.channels for _ in range(c.start, c.stop))

    def of_kind(self, *kinds: ChannelKind) -> tuple[Channel, ...]:
        """The channels of these kinds."""
        return tuple(c for c in self.channels if c.kind in kinds)

    def of_arm(self, arm: str) -> Iterator[Channel]:
        """The channels of one arm."""
        return (c for c in self.channels if c.arm == arm)

    def channel(self, arm: str, kind: ChannelKind) -> Channel | None:
        """The channel of an arm and a kind, if there is one."""
        return next((c for c in self.of_arm(arm) if c.kind == kind), None)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Any) -> Control:
        """What :meth:`to_json` gave, or its form of version 0.1.

        Raises:
            CheckpointError: naming the first thing that does not fit.
        """
        return convert(_upgraded(values), cls, CheckpointError, "control")


def _upgraded(values: Any) -> Any:
    """The present JSON form of a control of version 0.1, which drove one Panda; anything else as it is."""
    if not isinstance(values, dict) or "vectors" not in values:
        return values
    if not isinstance(values.get("arm"), dict):
        return {"channels": []}
    chain = dict(values["arm"])
    units = {"translation": chain.get("position_unit"), "rotation": chain.get("rotation_unit")}
    vectors = [
        {"kind": kind, "start": 3 * k, "stop": 3 * k + 3, "unit": unit, "arm": "arm"}
        for k, (kind, unit) in enumerate(units.items())
    ]
    gripper = {"kind": "gripper", "start": 6, "stop": 7, "rest": 1.0, "arm": "arm"}
    return {"channels": [*vectors, gripper], "arms": [{"name": "arm", "hand": "hand", "chain": chain}]}
