"""Sizes of a parallel gripper, in the frame of its tool centre: x across the fingers, y along their closing, z down."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FETCH", "PANDA", "ROBOTIQ", "Gripper"]


@dataclass(frozen=True)
class Gripper:
    """Two fingers under a hand; lengths in metres."""

    opening: float
    """Largest distance between the pads."""
    finger_depth: float
    """Of a finger, from its pad outward along y."""
    finger_half_width: float
    """Of a finger along x."""
    pad_half_width: float
    """Of the part of a finger that presses."""
    finger_tip: float
    """From the tool centre down to the ends of the fingers."""
    hand_height: float
    """From the tool centre up to the underside of the hand."""
    hand_half_width: float
    """Of the hand along x."""
    hand_half_length: float
    """Of the hand along y."""
    tool_ratio: float
    """Where the tool centre is on the line from the mean of the hand's cloud through that of both fingers': (tool -
    fingers) / (fingers - hand)."""
    shut_apart: float
    """Distance between the means of the fingers' clouds where the pads touch."""
    pad_end: float
    """From the tool centre down to what still counts as between the pads."""
    pad_reach: float
    """From the tool centre along x to what still counts as between the pads."""
    tool_reach: float | None = None
    """From the mean of the hand's cloud to the tool centre, where the fingers do not move straight; :attr:`tool_ratio`
    then does not count."""
    pressed: float = -0.0005
    """Sum of both pads' gaps to what is between them below which they press on it."""


PANDA = Gripper(
    opening=0.08,
    finger_depth=0.026,
    finger_half_width=0.011,
    pad_half_width=0.009,
    finger_tip=0.0095,
    hand_height=0.037,
    hand_half_width=0.032,
    hand_half_length=0.104,
    tool_ratio=0.355,
    shut_apart=0.027,
    pad_end=0.012,
    pad_reach=0.014,
)
"""The Franka Panda's hand, measured on the collision meshes that ManiSkill ships."""

FETCH = Gripper(
    opening=0.1018,
    finger_depth=0.014,
    finger_half_width=0.0135,
    pad_half_width=0.0135,
    finger_tip=0.0185,
    hand_height=0.052,
    hand_half_width=0.04,
    hand_half_length=0.063,
    tool_ratio=0.215,
    shut_apart=0.014,
    pad_end=0.021,
    pad_reach=0.0165,
)
"""The Fetch's hand, of a box around it and of its fingers' boxes; x is along the hand's z axis."""

ROBOTIQ = Gripper(
    opening=0.085,
    finger_depth=0.0315,
    finger_half_width=0.011,
    pad_half_width=0.011,
    finger_tip=0.018,
    hand_height=0.055,
    hand_half_width=0.0375,
    hand_half_length=0.0424,
    tool_ratio=0.304,
    shut_apart=0.024,
    pad_end=0.018,
    pad_reach=0.014,
    tool_reach=0.109,
    pressed=0.0005,
)
"""The Robotiq 2F-85, measured on the hulls that OGBench's model collides; its fingers swing, and reach 13 mm farther
when shut: the tips are those of a shut gripper, the ratio that of an open one."""
