"""Onset error: does a model foresee that an object at rest is about to move?

Averages over rollouts hide it: most steps of most objects are rest or carrying. An onset is a step in which an object's
centre moves by more than 1 mm after one of less than 0.2 mm. From the true scene before it, one step is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from pwm_gym.data.dataset import Dataset
from pwm_gym.data.episodes import Episode
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.protocols import MovesFewerPoints
from pwm_gym.scene import Layout, RigidState, State, batch_state, spacing
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.sim import Simulator

__all__ = ["CAUSES", "Cause", "Onset", "find_onsets", "onset_errors", "onset_floor"]

Cause = Literal["pushed by the robot", "pushed by an object", "released", "unsupported", "other"]
CAUSES: tuple[Cause, ...] = ("pushed by the robot", "pushed by an object", "released", "unsupported", "other")

_MOVES, _RESTS = 1e-3, 2e-4  # metres a step of the object's centre
_TOUCH = 0.002  # metres between surfaces that touch, beside what sampling adds
_STIRS = 5e-4  # metres a step: less is no motion of a neighbour, and no opening of a gripper
_AGREES = 0.3  # cosine between the motions of an object and of what pushes it
_FALLS = 0.7  # cosine between an object's motion and straight down
_FORESEEN = 0.5  # of the true way
_CHUNK = 256  # onsets that are predicted at once
_NUDGE = 5e-4  # metres


@dataclass(frozen=True)
class Onset:
    """A step in which an object begins to move."""

    episode: int
    """Place among the data set's episodes."""
    step: int
    """The object rests until this step's start and moves in it."""
    entity: int
    """Place of the object in the layout."""
    way: np.ndarray
    """Motion (3,) of its centre in the step, metres, base frame."""
    cause: Cause
    """See :func:`find_onsets`."""


@dataclass(frozen=True)
class _Contact:
    """An object and a neighbour in one step."""

    before: bool
    """Whether they touch at its start."""
    after: bool
    """Whether they touch at its end."""
    parted: float
    """Metres by which the gap between them grew."""
    motion: np.ndarray
    """Motion (3,) of the neighbour where it is nearest, metres."""

    @property
    def moves(self) -> bool:
        """Whether the neighbour touches at either end, and moves."""
        return (self.before or self.after) and bool(np.linalg.norm(self.motion) > _STIRS)

    def pushes(self, way: np.ndarray) -> bool:
        """Whether the neighbour moves roughly as the object does."""
        return self.moves and _cosine(self.motion, way) > _AGREES


def find_onsets(dataset: Dataset) -> list[Onset]:
    """Onsets of every loose and articulated entity, each with its cause.

    The cause is the first rule that holds, read off true poses and clouds at the step's start and end. Two bodies touch
    where their clouds come closer than 2 mm beside the coarser one's spacing.

    1. *pushed by the robot*: a link touches the object and moves, where it is nearest, roughly as the object does.
    2. *released*: a link touches it at the step's start, fingers spread or the link draws away, and the object falls.
    3. *pushed by an object*: as 1, of an entity that the robot does not drive.
    4. *unsupported*: it falls.
    5. *pushed by the robot*, *pushed by an object*: a link, or another entity, touches it and moves, however.
    6. *other*.
    """
    return [
        Onset(index, step, entity, way, _cause(dataset, episode, step, entity, way))
        for index, episode in enumerate(dataset.episodes)
        for entity in _objects(dataset.layout)
        for step, way in _beginnings(dataset, episode, entity)
    ]


def _objects(layout: Layout) -> tuple[int, ...]:
    """Places of the entities that contact moves."""
    return tuple(sorted((*layout.loose, *layout.articulated)))


def _beginnings(dataset: Dataset, episode: Episode, entity: int) -> list[tuple[int, np.ndarray]]:
    """Steps in which an entity begins to move, with the motion (3,) of its centre."""
    centre = dataset.scene(episode).clouds[dataset.layout.entities[entity].slice].mean(0)
    poses = matrix_from_pose7(torch.as_tensor(episode.poses[:, entity], dtype=torch.float64)).numpy()
    motion = np.diff(poses[:, :3, :3] @ centre + poses[:, :3, 3], axis=0)  # (T, 3)
    length = np.linalg.norm(motion, axis=1)
    steps = np.flatnonzero((length[1:] > _MOVES) & (length[:-1] < _RESTS)) + 1
    return [(int(step), motion[step]) for step in steps]


def _cause(dataset: Dataset, episode: Episode, step: int, entity: int, way: np.ndarray) -> Cause:
    layout = dataset.layout
    contacts = _contacts(dataset, episode, step, entity)
    links = [contact for i, contact in contacts.items() if layout.entities[i].driven]
    others = [contact for i, contact in contacts.items() if not layout.entities[i].driven]
    falls = _cosine(way, np.array([0.0, 0.0, -1.0])) > _FALLS
    spread = _spread(layout, episode.poses[step : step + 2]) > _STIRS
    if any(link.pushes(way) for link in links):
        return "pushed by the robot"
    if falls and any(link.before and (spread or link.parted > _MOVES) for link in links):
        return "released"
    if any(other.pushes(way) for other in others):
        return "pushed by an object"
    if falls:
        return "unsupported"
    if any(link.moves for link in links):
        return "pushed by the robot"
    if any(other.moves for other in others):
        return "pushed by an object"
    return "other"


def _contacts(dataset: Dataset, episode: Episode, step: int, entity: int) -> dict[int, _Contact]:
    """Entity -> its contact with the object at ``entity`` in a step, for all others."""
    layout, clouds = dataset.layout, dataset.scene(episode).clouds
    poses = matrix_from_pose7(torch.as_tensor(episode.poses[step : step + 2], dtype=torch.float64))
    cloud = torch.as_tensor(clouds).expand(2, -1, -1)
    points = RigidState(layout, cloud, poses.float().unsqueeze(1).expand(-1, 3, -1, -1, -1)).points().numpy()
    own = layout.entities[entity].slice
    trees = [cKDTree(frame[own]) for frame in points]
    grain = _grain(clouds[own])
    found = {}
    for i, other in enumerate(layout):
        if i == entity:
            continue
        gaps = [tree.query(frame[other.slice])[0] for tree, frame in zip(trees, points, strict=True)]
        smallest = [float(gap.min()) for gap in gaps]
        limit = _TOUCH + max(grain, _grain(clouds[other.slice]))
        nearest = int(gaps[int(smallest[1] <= smallest[0])].argmin())  # at the end where they are closer
        motion = points[1, other.slice][nearest] - points[0, other.slice][nearest]
        found[i] = _Contact(smallest[0] < limit, smallest[1] < limit, smallest[1] - smallest[0], motion)
    return found


def _grain(cloud: np.ndarray) -> float:
    """Mean distance of a point (n, 3) to its nearest neighbour, metres."""
    return float(spacing(cloud, 1).mean())


def _spread(layout: Layout, poses: np.ndarray) -> float:
    """Metres by which any two fingers of one hand part between two frames (2, E, 7)."""
    fingers = [i for i in layout.driven if layout.entities[i].joint.moves]
    largest = 0.0
    for a in fingers:
        for b in fingers:
            if a < b and layout.entities[a].joint.parent == layout.entities[b].joint.parent:
                before, after = np.linalg.norm(poses[:, a, :3] - poses[:, b, :3], axis=1)
                largest = max(largest, float(after - before))
    return largest


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    """Cosine between two vectors (3,); 0 where one of them has no length."""
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / length if length > 0.0 else 0.0


@torch.no_grad()
def onset_errors(model: WorldModel, dataset: Dataset, onsets: Sequence[Onset] | None = None) -> dict[str, Any] | None:
    """How well a model foresees onsets, each from the true scene (three true poses, joints) before it.

    Args:
        model: world model on the CPU.
        dataset: episodes.
        onsets: of the data set; None finds them.

    Returns:
        "count"; "median" of the centre's error over its true way (1: no motion was predicted); "foreseen", the share
        whose predicted motion goes more than half of the true way, along it; the same of each cause in "causes" and of
        each object in "objects". None where there is no onset.
    """
    onsets = find_onsets(dataset) if onsets is None else onsets
    if not onsets:
        return None
    predicted = np.concatenate(
        [_predict(model, dataset, onsets[k : k + _CHUNK]) for k in range(0, len(onsets), _CHUNK)]
    )
    return _summary(dataset.layout, onsets, predicted)


def _predict(model: WorldModel, dataset: Dataset, onsets: Sequence[Onset]) -> np.ndarray:
    """Motion (M, 3) that a model predicts of each onset's object."""
    start = batch_state([dataset.scene(dataset.episodes[o.episode], o.step) for o in onsets])
    few = model.moved_points if isinstance(model, MovesFewerPoints) else 0
    start = start.coarsen(start.layout.truncate(few)) if few else start
    actions = np.stack([dataset.episodes[o.episode].actions[o.step] for o in onsets])
    before: State = model.prepare(start)
    after = model.step(before, torch.as_tensor(actions))
    return (_centres(after, dataset, onsets) - _centres(before, dataset, onsets)).numpy()


def _centres(state: State, dataset: Dataset, onsets: Sequence[Onset]) -> Tensor:
    """World-frame centre (M, 3) of each onset's object."""
    slices = [dataset.layout.entities[o.entity].slice for o in onsets]
    clouds = [dataset.scene(dataset.episodes[o.episode]).clouds for o in onsets]
    centres = torch.as_tensor(np.stack([c[s].mean(0) for c, s in zip(clouds, slices, strict=True)]))
    poses = state.poses()[torch.arange(len(onsets)), torch.tensor([o.entity for o in onsets])].float()
    return (poses[:, :3, :3] @ centres.float().unsqueeze(-1)).squeeze(-1) + poses[:, :3, 3]


def _summary(layout: Layout, onsets: Sequence[Onset], predicted: np.ndarray) -> dict[str, Any]:
    """Shares over all onsets, over those of each cause and over those of each object."""
    ways = np.stack([o.way for o in onsets])
    length = np.linalg.norm(ways, axis=1)
    relative = np.linalg.norm(predicted - ways, axis=1) / length
    along = (predicted * ways).sum(1) / length**2

    def told(chosen: np.ndarray) -> dict[str, Any]:
        return {
            "count": int(chosen.sum()),
            "median": float(np.median(np.nan_to_num(relative[chosen], nan=np.inf))),
            "foreseen": float((along[chosen] > _FORESEEN).mean()),
        }

    causes, entities = np.array([o.cause for o in onsets]), np.array([o.entity for o in onsets])
    return {
        **told(np.ones(len(onsets), bool)),
        "causes": {c: told(causes == c) for c in CAUSES if (causes == c).any()},
        "objects": {e.name: told(entities == i) for i, e in enumerate(layout) if (entities == i).any()},
    }


def onset_floor(
    simulator: Simulator, dataset: Dataset, onsets: Sequence[Onset] | None = None, most: int = 200
) -> dict[str, Any] | None:
    """The same of the simulator itself, started with the object moved by 0.5 mm: what chaos alone costs.

    Args:
        simulator: of the task.
        dataset: episodes.
        onsets: of the data set; None finds them.
        most: onsets that are tried, evenly chosen.
    """
    every = find_onsets(dataset) if onsets is None else onsets
    if not every:
        return None
    chosen = [every[i] for i in np.unique(np.linspace(0, len(every) - 1, most).round().astype(int))]
    seed: int | None = None
    motions = []
    for onset in chosen:
        episode = dataset.episodes[onset.episode]
        if seed != episode.seed:
            seed = episode.seed
            simulator.reset(seed)
        scene = dataset.scene(episode, onset.step)
        poses = scene.poses.copy()
        poses[:, onset.entity, 0] += _NUDGE
        simulator.restore(replace(scene, poses=poses))
        simulator.step(episode.actions[onset.step])
        motions.append(_moved(scene.clouds, dataset.layout, onset.entity, poses[0], simulator.poses()))
    return _summary(dataset.layout, chosen, np.stack(motions))


def _moved(clouds: np.ndarray, layout: Layout, entity: int, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Motion (3,) of an entity's centre between two frames (E, 7)."""
    centre = clouds[layout.entities[entity].slice].mean(0)
    poses = matrix_from_pose7(torch.as_tensor(np.stack([before[entity], after[entity]]), dtype=torch.float64)).numpy()
    motion: np.ndarray = (poses[1] - poses[0])[:3, :3] @ centre + (poses[1] - poses[0])[:3, 3]
    return motion
