"""How fast an arm's joints move, where only its hand is seen."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["JointSpeeds"]


@dataclass(frozen=True)
class JointSpeeds:
    """What tells the speed of an arm's fastest joint from the motion of its hand, which points down.

    The bending joints move the hand in its upright plane, the first joint moves it sideways, and the last one makes
    the turn that the first one does not.
    """

    joints: int
    """Number of the arm's joints, which come first among the robot's."""
    period: float
    """Seconds per control step."""
    bending: tuple[tuple[float, float], ...]
    """Speed (rad/s) of each bending joint per radial and per vertical speed (m/s) of the hand."""
    averaged: float = 1.0
    """Joint speed at a step's end over its average in the step, where the arm comes to rest."""
