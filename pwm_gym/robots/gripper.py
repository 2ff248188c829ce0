"""Sizes of a parallel gripper, in the frame of its tool centre: x across the fingers, y along their closing, z down."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PANDA", "Gripper"]


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


PANDA = Gripper(
    opening=0.08,
    finger_depth=0.026,
    finger_half_width=0.011,
    pad_half_width=0.009,
    finger_tip=0.0095,
    hand_height=0.037,
    hand_half_width=0.032,
    hand_half_length=0.104,
)
"""The Franka Panda's hand, measured on the collision meshes that ManiSkill ships."""
