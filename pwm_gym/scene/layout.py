"""Which slice of a cloud belongs to which rigid part of the scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError, unknown_name

__all__ = ["Entity", "Layout", "Slider"]


@dataclass(frozen=True)
class Slider:
    """Prismatic joint of a robot's link, read from its URDF: the link slides on ``parent`` along one axis."""

    parent: str
    """Entity that carries the link."""
    origin: tuple[float, ...]
    """Pose (7,) of the link in the parent's frame at opening 0 (metres, wxyz)."""
    axis: tuple[float, float, float]
    """Unit direction of opening, in the link's own frame at opening 0."""
    upper: float
    """Largest opening in metres; the smallest is 0."""


@dataclass(frozen=True)
class Entity:
    """A rigid part of the scene and its slice ``start:stop`` of the scene's points."""

    name: str
    start: int
    stop: int
    effector: bool = False
    """Whether the robot drives it (an end-effector link), rather than contact."""
    slider: Slider | None = None

    @property
    def points(self) -> int:
        """How many points it has."""
        return self.stop - self.start

    @property
    def slice(self) -> slice:
        """Its place among the scene's points."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class Layout:
    """The entities of a task in the order of their points.

    Example:
        >>> layout = Layout.build([("hand", 300), ("cube", 300)], effectors=("hand",))
        >>> layout["cube"].slice, layout.points
        (slice(300, 600, None), 600)
    """

    entities: tuple[Entity, ...]

    @classmethod
    def build(
        cls,
        counts: Sequence[tuple[str, int]],
        effectors: Sequence[str] = (),
        sliders: dict[str, Slider] | None = None,
    ) -> Layout:
        """Layout of named point counts, one slice after the other."""
        entities, start = [], 0
        for name, count in counts:
            slider = (sliders or {}).get(name)
            entities.append(Entity(name, start, start + count, name in effectors, slider))
            start += count
        return cls(tuple(entities))

    def resize(self, points: int) -> Layout:
        """The same entities with ``points`` points in all, divided in the same proportions."""
        if not len(self.entities) <= points <= self.points:
            raise PwmGymError(f"points={points}; expected {len(self.entities)} to {self.points}")
        bounds = [round(e.stop * points / self.points) for e in self.entities]
        return self._with_counts(map(int, np.diff([0, *bounds])))

    def truncate(self, count: int) -> Layout:
        """The same entities with at most ``count`` points each."""
        return self._with_counts(min(count, e.points) for e in self.entities)

    def _with_counts(self, counts: Iterable[int]) -> Layout:
        effectors = [e.name for e in self.entities if e.effector]
        sliders = {e.name: e.slider for e in self.entities if e.slider}
        return Layout.build(list(zip(self.names, counts, strict=True)), effectors, sliders)

    @property
    def names(self) -> tuple[str, ...]:
        """Entity names, in order."""
        return tuple(e.name for e in self.entities)

    @property
    def root(self) -> int:
        """Position of the end effector's root link: of those that the robot drives, the one that slides on no other."""
        return next(i for i, e in enumerate(self.entities) if e.effector and e.slider is None)

    @property
    def points(self) -> int:
        """Number N of points of a scene."""
        return self.entities[-1].stop

    @cached_property
    def ids(self) -> np.ndarray:
        """Index (N,) of each point's entity."""
        return np.repeat(np.arange(len(self.entities)), [e.points for e in self.entities])

    def index(self, name: str) -> int:
        """Position of the entity called ``name``."""
        if name not in self.names:
            raise unknown_name("entity", name, self.names)
        return self.names.index(name)

    def __getitem__(self, name: str) -> Entity:
        return self.entities[self.index(name)]

    def __iter__(self) -> Iterator[Entity]:
        return iter(self.entities)

    def __len__(self) -> int:
        return len(self.entities)

    def to_json(self) -> list[dict[str, Any]]:
        """JSON form, read back by :meth:`from_json`."""
        return [asdict(e) for e in self.entities]

    @classmethod
    def from_json(cls, data: list[dict[str, Any]]) -> Layout:
        """Layout of its JSON form."""

        def entity(item: dict[str, Any]) -> Entity:
            slider = item.get("slider")
            if slider is not None:
                slider = Slider(slider["parent"], tuple(slider["origin"]), tuple(slider["axis"]), slider["upper"])
            return Entity(item["name"], item["start"], item["stop"], item["effector"], slider)

        return cls(tuple(map(entity, data)))
