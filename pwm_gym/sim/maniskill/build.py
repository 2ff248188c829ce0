"""Solids of boxes and cylinders in a ManiSkill scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pwm_gym.sim.shapes import Box, Shape

__all__ = ["add_shapes"]


def add_shapes(
    builder: Any, shapes: Sequence[Shape], color: Sequence[float], density: float = 1000.0, material: Any = None
) -> None:
    """Give an actor or a link the shapes' collisions and looks.

    Args:
        builder: of the actor or the link.
        shapes: in its frame.
        color: red, green, blue and opacity in [0, 1].
        density: kilograms per cubic metre.
        material: of physics; None is ManiSkill's default.
    """
    import sapien

    look = sapien.render.RenderMaterial()
    look.set_base_color(list(color))
    for shape in shapes:
        if isinstance(shape, Box):
            pose = sapien.Pose(shape.centre, shape.quaternion)
            half = [0.5 * side for side in shape.size]
            builder.add_box_collision(pose, half, material, density)
            builder.add_box_visual(pose, half, look)
        else:
            pose = sapien.Pose(shape.centre, [0.5**0.5, 0.0, 0.5**0.5, 0.0])  # SAPIEN's cylinders lie along x
            builder.add_cylinder_collision(pose, shape.radius, 0.5 * shape.height, material, density)
            builder.add_cylinder_visual(pose, shape.radius, 0.5 * shape.height, look)
