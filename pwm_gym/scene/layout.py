"""Which slice of a cloud belongs to which rigid part of the scene, and how the parts hang on each other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pwm_gym.errors import SceneError, check_whole, unknown_name
from pwm_gym.scene.joint import FREE, IDENTITY, Joint, Pose7

__all__ = ["Entity", "Layout", "Support"]

_EXTENT, _WIDE = 100.0, 50.0  # metres: half the width of a support that has no edge, and what counts as one
_NO_FLOOR = -1e3  # metres


@dataclass(frozen=True)
class Entity:
    """A rigid part of the scene and its slice ``start:stop`` of the scene's points."""

    name: str
    start: int
    stop: int
    driven: bool = False
    """Whether the robot's controller moves it, rather than contact."""
    joint: Joint = FREE
    """How it hangs on its parent; a hand, which its arm moves, is free."""

    @property
    def points(self) -> int:
        """How many points it has."""
        return self.stop - self.start

    @property
    def slice(self) -> slice:
        """Its place among the scene's points."""
        return slice(self.start, self.stop)

    @property
    def articulated(self) -> bool:
        """Whether contact moves it along a joint: a drawer, a lid."""
        return self.joint.moves and not self.driven

    @property
    def loose(self) -> bool:
        """Whether contact moves it freely."""
        return self.joint.kind == "free" and not self.driven


@dataclass(frozen=True)
class Support:
    """A fixed box of the world that has no points: a table, the ground, a wall."""

    origin: Pose7 = IDENTITY
    """Pose of the box's centre in the base's frame."""
    half: tuple[float, float, float] = (_EXTENT, _EXTENT, 1.0)
    """Half its sides, metres."""

    @property
    def plane(self) -> bool:
        """Whether it is horizontal and has no edges within reach."""
        return min(self.half[:2]) >= _WIDE and self.origin[3] == 1.0

    @property
    def top(self) -> float:
        """Height of its top in its own axes, metres."""
        return self.origin[2] + self.half[2]

    @classmethod
    def ground(cls, height: float = 0.0) -> Support:
        """A horizontal plane at ``height`` metres, solid below."""
        return cls((0.0, 0.0, height - 1.0, 1.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Layout:
    """The entities of a scene in the order of their points.

    Raises:
        SceneError: a name twice, a slice that does not follow the one before it, a joint whose parent or whose
            followed joint is missing, or joints that make a circle.

    Example:
        >>> layout = Layout.build([("hand", 300), ("cube", 300)], driven=("hand",))
        >>> layout["cube"].slice, layout.points
        (slice(300, 600, None), 600)
    """

    entities: tuple[Entity, ...]
    supports: tuple[Support, ...] = ()
    """What of the world can be touched."""

    def __post_init__(self) -> None:
        """Check that the entities fit each other."""
        start, names = 0, set()
        for e in self.entities:
            if e.name in names:
                raise SceneError(f"two entities are called {e.name!r}")
            if e.start != start or e.stop <= start:
                raise SceneError(f"entity {e.name!r} has points {e.start} to {e.stop}; expected to begin at {start}")
            names.add(e.name)
            start = e.stop
        for e in self.entities:
            self._check_joint(e, names)

    def _check_joint(self, entity: Entity, names: set[str]) -> None:
        joint, name = entity.joint, entity.name
        if joint.parent is not None and joint.parent not in names:
            raise SceneError(
                f"the joint of {name!r} has parent {joint.parent!r}; expected one of {', '.join(self.names)}"
            )
        if joint.mimic is not None:
            self._check_mimic(entity, joint.mimic.entity)
        ancestor, seen = joint.parent, [name]
        while ancestor is not None:
            if ancestor in seen:
                raise SceneError(f"joints make a circle: {' on '.join([*seen, ancestor])}")
            seen.append(ancestor)
            ancestor = self[ancestor].joint.parent

    def _check_mimic(self, entity: Entity, followed: str) -> None:
        what = f"the joint of {entity.name!r} follows"
        if followed == entity.name:
            raise SceneError(f"{what} itself")
        if followed not in self.names:
            raise SceneError(f"{what} that of {followed!r}, which is no entity")
        leader = self[followed]
        if not leader.joint.moves:
            raise SceneError(f"{what} that of {followed!r}, which does not move")
        if leader.joint.mimic is not None:
            raise SceneError(f"{what} that of {followed!r}, which follows another")
        if leader.driven != entity.driven:
            who = "does not move" if entity.driven else "moves"
            raise SceneError(f"{what} that of {followed!r}, which the robot {who}")

    @classmethod
    def build(
        cls,
        counts: Sequence[tuple[str, int]],
        driven: Sequence[str] = (),
        joints: Mapping[str, Joint] | None = None,
        supports: Sequence[Support] = (),
    ) -> Layout:
        """Layout of named point counts, one slice after the other.

        Args:
            counts: name and number of points of each entity.
            driven: names of those that the robot moves.
            joints: name -> joint; the others are free.
            supports: what of the world can be touched.
        """
        entities, start, known = [], 0, joints or {}
        for name, count in counts:
            entities.append(Entity(name, start, start + count, name in driven, known.get(name, FREE)))
            start += count
        if unknown := sorted({*driven, *known} - {e.name for e in entities}):
            raise unknown_name("entity", unknown[0], [e.name for e in entities])
        return cls(tuple(entities), tuple(supports))

    def resize(self, points: int) -> Layout:
        """The same entities with ``points`` points in all, divided in the same proportions."""
        count = len(self.entities)
        points = check_whole("points", points, count, self.points)
        share = (points - count) / max(1, self.points - count)  # of what is left when each has one point
        bounds = np.floor(share * np.cumsum([e.points - 1 for e in self.entities]) + 0.5)
        return self.with_counts(int(1 + extra) for extra in np.diff([0, *bounds]))

    def kept(self, coarser: Layout) -> np.ndarray:
        """Places (M,) of the points that a ``coarser`` layout of the same entities keeps: the first of each entity."""
        pairs = zip(self.entities, coarser.entities, strict=True)
        return np.concatenate([np.arange(e.start, e.start + few.points) for e, few in pairs])

    def truncate(self, count: int) -> Layout:
        """The same entities with at most ``count`` points each."""
        return self.with_counts(min(count, e.points) for e in self.entities)

    def with_counts(self, counts: Iterable[int]) -> Layout:
        """The same entities with other numbers of points."""
        entities, start = [], 0
        for entity, count in zip(self.entities, counts, strict=True):
            entities.append(replace(entity, start=start, stop=start + count))
            start += count
        return replace(self, entities=tuple(entities))

    def plus(self, others: Iterable[Entity]) -> Layout:
        """This layout with further entities, whose points follow."""
        entities = [*self.entities]
        for other in others:
            start = entities[-1].stop if entities else 0
            entities.append(replace(other, start=start, stop=start + other.points))
        return replace(self, entities=tuple(entities))

    def robot(self) -> Layout:
        """The driven entities alone: what a world model belongs to."""
        return replace(self, supports=()).only([e.name for e in self if e.driven])

    def only(self, names: Sequence[str]) -> Layout:
        """The entities of these names alone, in this layout's order."""
        kept = [e for e in self if e.name in names]
        return replace(self, entities=()).plus(kept)

    @property
    def names(self) -> tuple[str, ...]:
        """Entity names, in order."""
        return tuple(e.name for e in self.entities)

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """Positions of the entities that the robot moves."""
        return tuple(i for i, e in enumerate(self.entities) if e.driven)

    @cached_property
    def hands(self) -> tuple[int, ...]:
        """Positions of the driven entities that hang on no other: each at the end of an arm."""
        return tuple(i for i in self.driven if self.entities[i].joint.kind == "free")

    @cached_property
    def loose(self) -> tuple[int, ...]:
        """Positions of the entities that contact moves freely."""
        return tuple(i for i, e in enumerate(self.entities) if e.loose)

    @cached_property
    def articulated(self) -> tuple[int, ...]:
        """Positions of the entities that contact moves along a joint, parents first."""
        found = [i for i, e in enumerate(self.entities) if e.articulated]
        return tuple(sorted(found, key=self.depth))

    def depth(self, index: int) -> int:
        """Number of entities that the one at ``index`` hangs on."""
        return len(self.ancestors(index))

    def root(self, index: int) -> int:
        """Position of what the entity at ``index`` hangs on in the end; its own where that is the world."""
        return (index, *self.ancestors(index))[-1]

    def ancestors(self, index: int) -> list[int]:
        """Positions of the entities that the one at ``index`` hangs on, its parent first."""
        found, parent = [], self.entities[index].joint.parent
        while parent is not None:
            found.append(self.index(parent))
            parent = self[parent].joint.parent
        return found

    @cached_property
    def attached(self) -> tuple[int, ...]:
        """Positions of the entities that are fixed to one that can move."""
        fixed = [i for i, e in enumerate(self.entities) if e.joint.kind == "fixed"]
        return tuple(i for i in fixed if any(self.entities[k].joint.kind != "fixed" for k in self.ancestors(i)))

    @property
    def floor(self) -> float:
        """Height of the highest horizontal support without edges, metres; far below where there is none."""
        return max((s.top for s in self.supports if s.plane), default=_NO_FLOOR)

    @property
    def points(self) -> int:
        """Number N of points of a scene."""
        return self.entities[-1].stop if self.entities else 0

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

    def to_json(self) -> dict[str, Any]:
        """JSON form, read back by :meth:`from_json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Any) -> Layout:
        """Layout of its JSON form, or of that of version 0.1 (a list of entities with sliders).

        Raises:
            SceneError: naming the first thing that does not fit.
        """
        from pwm_gym.scene.legacy import upgrade_layout
        from pwm_gym.schema import convert

        return convert(upgrade_layout(data), cls, SceneError, "layout")
