"""Primitive shapes that a simulator can put into any scene beside the task's own objects, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pwm_gym.errors import look_up

if TYPE_CHECKING:
    import trimesh

__all__ = ["PROPS", "Prop", "get_prop", "register_prop"]


@dataclass(frozen=True)
class Prop:
    """A primitive shape whose frame lies at its centre, z up. Metres."""

    name: str
    kind: Literal["box", "cylinder"]
    size: tuple[float, ...]
    """Sides (x, y, z) of a box; radius and height of a cylinder, whose axis is z."""

    @property
    def radius(self) -> float:
        """Of its bounding circle seen from above."""
        if self.kind == "cylinder":
            return self.size[0]
        return 0.5 * (self.size[0] ** 2 + self.size[1] ** 2) ** 0.5

    @property
    def half_height(self) -> float:
        """Of its centre above what it stands on."""
        return 0.5 * self.size[-1]

    def mesh(self) -> trimesh.Trimesh:
        """Its surface."""
        import trimesh

        make = {
            "box": lambda: trimesh.creation.box(self.size),
            "cylinder": lambda: trimesh.creation.cylinder(*self.size),
        }
        return make[self.kind]()


PROPS: dict[str, Prop] = {}
"""Name -> shape."""


def register_prop(prop: Prop) -> Prop:
    """Add ``prop`` to the registry.

    Raises:
        ValueError: the name is taken.
    """
    if prop.name in PROPS:
        raise ValueError(f"prop {prop.name!r} is registered already")
    PROPS[prop.name] = prop
    return prop


def get_prop(name: str) -> Prop:
    """The shape called ``name``.

    Raises:
        UnknownNameError: listing the known shapes and the nearest one.
    """
    return look_up("prop", name, PROPS)


register_prop(Prop("distractor_block", "box", (0.03, 0.03, 0.05)))
register_prop(Prop("distractor_can", "cylinder", (0.018, 0.06)))
register_prop(Prop("distractor_tile", "box", (0.05, 0.03, 0.02)))
register_prop(Prop("distractor_puck", "cylinder", (0.022, 0.015)))
register_prop(Prop("distractor_cube", "box", (0.035, 0.035, 0.035)))
