"""Cabinets with one drawer: their boxes, their joint and their handle. Metres.

The cabinet's frame lies in its middle, z up, x to its open front. The drawer's frame lies in the middle of its tray's
height, and has the cabinet's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from pwm_gym.scene.joint import Joint
from pwm_gym.sim.shapes import Box

__all__ = ["DEEP_CABINET", "LOW_CABINET", "Cabinet"]

_WALL = 0.008
_GAP = 0.003  # between drawer and cabinet
_TRAY_WALL = 0.006
_TRAY_HEIGHT = 0.044  # of walls with their floor
_HALF_HEIGHT = 0.5 * _TRAY_HEIGHT

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Cabinet:
    """A cabinet and its drawer. What is told of the drawer is in the drawer's frame."""

    half: Triple
    """Half the cabinet's sides."""
    stroke: float
    """Way of the drawer."""
    opened: float
    """Way of the drawer from which it counts as open."""
    handle_width: float
    """Thickness of the handle's bar."""
    bar_length: float
    """Length of the bar, which lies along y."""
    bar: Triple
    """Its middle: before the front, beside the drawer's middle, over the cabinet's middle."""
    put: tuple[float, float]
    """Where on the tray's floor things are put: behind the front, beside the middle."""

    @property
    def front(self) -> float:
        """Foremost x of the front panel."""
        return self.half[0]

    @property
    def _depth(self) -> float:
        """From the middle to the tray's back."""
        return self.half[0] - _WALL - _GAP

    @property
    def _width(self) -> float:
        """From the middle to the tray's side."""
        return self.half[1] - _WALL - _GAP

    @property
    def _origin(self) -> float:
        """Height of the drawer's frame in the cabinet's."""
        return -self.half[2] + _WALL + _GAP + 0.5 * _TRAY_HEIGHT

    @property
    def _panel(self) -> float:
        """Height of the front panel."""
        return 2 * (self.half[2] - _WALL - _GAP)

    @cached_property
    def joint(self) -> Joint:
        """Of the drawer on an entity called ``cabinet``."""
        origin = (0.0, 0.0, self._origin, 1.0, 0.0, 0.0, 0.0)
        return Joint("prismatic", "cabinet", origin, (1.0, 0.0, 0.0), 0.0, self.stroke)

    @property
    def handle(self) -> Triple:
        """Middle of the handle's bar."""
        ahead, aside, height = self.bar
        return (self.front + ahead, aside, height - self._origin)

    @property
    def gap_middle(self) -> float:
        """Middle x of the gap between the front and the bar."""
        return 0.5 * (self.front + self.handle[0] - 0.5 * self.handle_width)

    @cached_property
    def body(self) -> tuple[Box, ...]:
        """Bottom, top, sides and back, in the cabinet's frame."""
        x, y, z = self.half
        return (
            Box((2 * x, 2 * y, _WALL), (0.0, 0.0, -z + 0.5 * _WALL)),
            Box((2 * x, 2 * y, _WALL), (0.0, 0.0, z - 0.5 * _WALL)),
            Box((2 * x, _WALL, 2 * z), (0.0, -y + 0.5 * _WALL, 0.0)),
            Box((2 * x, _WALL, 2 * z), (0.0, y - 0.5 * _WALL, 0.0)),
            Box((_WALL, 2 * y, 2 * z), (-x + 0.5 * _WALL, 0.0, 0.0)),
        )

    @cached_property
    def drawer(self) -> tuple[Box, ...]:
        """Tray, front panel and handle."""
        depth, width, bar = self._depth, self._width, self.handle
        length, middle = self.front + depth, 0.5 * (self.front - depth)
        post = (self.bar[0] + _WALL, self.handle_width, self.handle_width)
        return (
            Box((length, 2 * width, _TRAY_WALL), (middle, 0.0, -_HALF_HEIGHT + 0.5 * _TRAY_WALL)),
            Box((length, _TRAY_WALL, _TRAY_HEIGHT), (middle, -width + 0.5 * _TRAY_WALL, 0.0)),
            Box((length, _TRAY_WALL, _TRAY_HEIGHT), (middle, width - 0.5 * _TRAY_WALL, 0.0)),
            Box((_TRAY_WALL, 2 * width, _TRAY_HEIGHT), (-depth + 0.5 * _TRAY_WALL, 0.0, 0.0)),
            Box((_WALL, 2 * width, self._panel), (self.front - 0.5 * _WALL, 0.0, -self._origin)),
            Box((self.handle_width, self.bar_length, self.handle_width), bar),
            *(
                Box(post, (bar[0] - 0.5 * post[0], bar[1] + side * 0.5 * (self.bar_length - post[1]), bar[2]))
                for side in (-1.0, 1.0)
            ),
        )

    @property
    def drawer_from(self) -> Triple:
        """The drawer's least x, y and z."""
        return (-self._depth, -self._width, -_HALF_HEIGHT)

    @property
    def drawer_to(self) -> Triple:
        """Its greatest ones."""
        return (self.handle[0] + 0.5 * self.handle_width, self._width, 0.5 * self._panel - self._origin)

    @property
    def tray(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y within the tray."""
        back, side = self._depth, self._width
        return ((-back + _TRAY_WALL, -side + _TRAY_WALL), (self.front - _WALL, side - _TRAY_WALL))

    @property
    def tray_floor(self) -> float:
        """Height of the tray's floor."""
        return -_HALF_HEIGHT + _TRAY_WALL

    @property
    def place(self) -> Triple:
        """Where on the floor things are put."""
        behind, aside = self.put
        return (self.front - behind, aside, self.tray_floor)


LOW_CABINET = Cabinet(
    half=(0.11, 0.12, 0.0525),
    stroke=0.16,
    opened=0.12,
    handle_width=0.012,
    bar_length=0.112,
    bar=(0.050, 0.0, 0.0235),  # at 32 and 42 mm fingers jam before the front; the hand passes over the cabinet
    put=(0.083, 0.0),  # far enough before the cabinet for a hand that comes down when it is open
)
"""Of one gripper, which grasps the bar from above."""

DEEP_CABINET = Cabinet(
    half=(0.12, 0.14, 0.075),
    stroke=0.18,
    opened=0.14,
    handle_width=0.016,
    bar_length=0.136,
    bar=(0.064, -0.060, 0.030),  # 4 cm are left for the left hand, which faces the cabinet, its palm over the front
    put=(0.075, 0.035),  # before the cabinet when it is open, away from the hand at the handle
)
"""Of two hands: a whole one fits between bar and front, beside the middle, so that the other reaches into the tray."""
