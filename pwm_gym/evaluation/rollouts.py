"""Open-loop rollouts of recorded episodes: the paper's setting, "observe three clouds, then predict" (section 4.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from pwm_gym.data.dataset import Dataset
from pwm_gym.data.episodes import DEMONSTRATIONS, KINDS, Episode
from pwm_gym.data.partial import partial_clouds
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.protocols import MovesArms, MovesFewerPoints
from pwm_gym.scene import PointState, RigidState, Scene, State, batch_state, joint_positions, stack
from pwm_gym.scene.se3 import inverse, matrix_from_pose7, rotation_angle

if TYPE_CHECKING:
    from pwm_gym.perception import RenderedObserver

__all__ = [
    "OBSERVED",
    "STEPS",
    "Rollouts",
    "at_steps",
    "canonical_clouds",
    "completed_start",
    "joint_errors",
    "long_rollouts",
    "observed_start",
    "predict",
    "validation_metrics",
]

OBSERVED = 3
"""Clouds that a model sees before it predicts."""
STEPS = (10, 30, 60)
"""Rollout steps at which entity errors are reported."""
_CHUNK = 128  # episodes rolled out at once


@dataclass(frozen=True)
class Rollouts:
    """Predictions for a list of episodes, padded to the longest."""

    dataset: Dataset
    """Where the episodes are from."""
    episodes: tuple[Episode, ...]
    poses: Tensor
    """Predicted poses (M, H, E, 4, 4)."""
    truth: Tensor
    """True poses (M, H, E, 4, 4)."""
    joints: Tensor
    """True joint positions and velocities (M, H, 2, J)."""
    actions: Tensor
    """(M, H, A)."""
    states: State
    """Predicted states (M, H); their points may be fewer than the data set's."""
    lengths: np.ndarray
    """Predicted steps of each episode (M,)."""

    @property
    def mask(self) -> Tensor:
        """Bool (M, H): steps that exist."""
        return torch.arange(self.poses.shape[1]) < torch.as_tensor(self.lengths)[:, None]

    def true_states(self, part: slice = slice(None)) -> RigidState:
        """True states (M, H) of some episodes; velocities of the first two steps count from the first true pose."""
        truth = self.truth[part]
        before = torch.cat([truth[:, :1], truth[:, :-1]], 1)
        earlier = torch.cat([before[:, :1], before[:, :-1]], 1)
        clouds = canonical_clouds(self.dataset, self.episodes[part]).unsqueeze(1).expand(-1, truth.shape[1], -1, -1)
        return RigidState(self.dataset.layout, clouds, torch.stack([truth, before, earlier], 2), self.joints[part])


@torch.no_grad()
def predict(
    model: WorldModel, dataset: Dataset, oracle_effector: bool = False, start: RigidState | None = None
) -> Rollouts:
    """Roll ``model`` out under the actions of each episode of ``dataset``.

    Args:
        model: world model on the CPU.
        dataset: episodes of one split.
        oracle_effector: whether the true end effector replaces the predicted one after each step.
        start: what is observed of each episode's first three steps (M,); None takes the complete truth, with as many
            points of each entity as a model of points was trained to move. Its canonical frames may differ from the
            true ones: predicted poses are told as motions of the true one at the start.
    """
    episodes = tuple(e for e in dataset.episodes if len(e) > OBSERVED - 1)
    lengths = np.array([len(e) - (OBSERVED - 1) for e in episodes])
    horizon = int(lengths.max())
    frames = torch.stack([_frames(e, horizon) for e in episodes])  # (M, H + 3, E, 4, 4)
    joints = torch.stack([_joints(e, horizon) for e in episodes])  # (M, H + 3, 2, J)
    actions = torch.stack([_actions(e, horizon) for e in episodes])
    begin = start or _complete_start(model, dataset)
    chunks, order = [], np.argsort(lengths, kind="stable")  # so that few steps are rolled past an episode's end
    for k in range(0, len(episodes), _CHUNK):
        part = torch.as_tensor(order[k : k + _CHUNK])
        oracle = (frames[part, 3:], joints[part, 3:]) if oracle_effector else None
        chunks.append(_roll(model, begin[part], actions[part], oracle, int(lengths[part].max())))
    states = _joined(chunks)[torch.as_tensor(np.argsort(order))]
    poses = states.poses()
    third = frames[:, OBSERVED - 1]
    if not torch.equal(begin.poses(), third):
        poses = poses @ inverse(begin.poses()).unsqueeze(1) @ third.unsqueeze(1)
    return Rollouts(dataset, episodes, poses, frames[:, 3:], joints[:, 3:], actions, states, lengths)


def _complete_start(model: WorldModel, dataset: Dataset) -> RigidState:
    """State (M,) of the third step of each episode, with the points that ``model`` was trained to move."""
    start = observed_start(dataset)
    count = model.moved_points if isinstance(model, MovesFewerPoints) else 0
    return start.coarsen(start.layout.truncate(count)) if count else start


def observed_start(dataset: Dataset, seen: np.ndarray | None = None) -> RigidState:
    """State (M,) of the third step of each episode that is predicted.

    Args:
        dataset: episodes of one split.
        seen: points (F, N) of each frame that a camera sees (:func:`pwm_gym.data.visibility`), from which a partial
            cloud is drawn; None takes the complete one.
    """
    lengths = np.array([len(e) for e in dataset.episodes])
    long = lengths > OBSERVED - 1
    episodes = [e for e, kept in zip(dataset.episodes, long, strict=True) if kept]
    layout, canonical = dataset.layout, canonical_clouds(dataset, episodes)
    if seen is not None:
        third = torch.as_tensor(seen[(np.cumsum(lengths + 1) - lengths - 1 + OBSERVED - 1)[long]])
        one = bool((canonical == canonical[:1]).all())  # of all episodes
        clouds = canonical[0] if one else canonical
        layout, canonical = partial_clouds(layout, clouds, third, torch.Generator().manual_seed(0))
    frames = torch.stack([_frames(e, 0) for e in episodes])  # (M, 3, E, 4, 4)
    joints = torch.stack([torch.as_tensor(e.joints[OBSERVED - 1]) for e in episodes])
    return RigidState(layout, canonical, frames.flip(1), joints)


def completed_start(dataset: Dataset, observer: Callable[[Scene], RenderedObserver]) -> RigidState:
    """State (M,) of the third step of each episode that is predicted, as perception makes it of three views.

    Args:
        dataset: episodes of one split.
        observer: who sees scenes of the assets of this one; asked for once a combination of assets.
    """
    observers: dict[tuple[str, ...], RenderedObserver] = {}
    scenes = []
    for index, episode in enumerate(dataset.episodes):
        if len(episode) > OBSERVED - 1:
            if episode.assets not in observers:
                observers[episode.assets] = observer(dataset.scene(episode))
            look = observers[episode.assets]
            look.reset(index)
            scenes.append([look(dataset.scene(episode, step)).scene for step in range(OBSERVED)][-1])
    return batch_state(scenes)


def canonical_clouds(dataset: Dataset, episodes: Sequence[Episode]) -> Tensor:
    """Canonical points (M, N, 3) of episodes, whose objects may differ."""
    return torch.as_tensor(np.stack([dataset.scene(e).clouds for e in episodes]), dtype=torch.float32)


def at_steps(errors: np.ndarray, lengths: np.ndarray) -> dict[str, dict[str, float]]:
    """Mean, median and count of errors (M, H) at :data:`STEPS`, at half of each episode and at its last step.

    Args:
        errors: after each rollout step, which count from 1.
        lengths: steps of each episode (M,); those that are too short for a step are left out.
    """
    columns = {str(k): errors[lengths >= k, k - 1] for k in STEPS if k <= errors.shape[1]}
    for name, after in (("half", (lengths + 1) // 2), ("last", lengths)):
        columns[name] = errors[np.arange(len(errors)), after - 1]
    return {
        k: {"mean": float(v.mean()), "median": float(np.median(v)), "episodes": len(v)}
        for k, v in columns.items()
        if len(v)
    }


def _frames(episode: Episode, horizon: int) -> Tensor:
    """True poses (H + 3, E, 4, 4), the last one repeated past the end."""
    index = np.minimum(np.arange(horizon + OBSERVED), len(episode))
    return matrix_from_pose7(torch.as_tensor(episode.poses[index], dtype=torch.float64)).float()


def _joints(episode: Episode, horizon: int) -> Tensor:
    """True joint positions and velocities (H + 3, 2, J), the last ones repeated past the end."""
    index = np.minimum(np.arange(horizon + OBSERVED), len(episode))
    return torch.as_tensor(episode.joints[index])


def _actions(episode: Episode, horizon: int) -> Tensor:
    index = np.minimum(np.arange(horizon) + OBSERVED - 1, len(episode) - 1)
    return torch.as_tensor(episode.actions[index])


def _roll(
    model: WorldModel, start: RigidState, actions: Tensor, oracle: tuple[Tensor, Tensor] | None, steps: int
) -> State:
    """States (B, H), after so many ``steps`` the last one.

    The effector's true poses (B, H, E, 4, 4) and joints (B, H, 2, J) overwrite the predicted ones.
    """
    links = torch.tensor([e.driven for e in start.layout])
    state: State = model.prepare(start)
    states = []
    for h in range(steps):
        state = model.step(state, actions[:, h])
        if oracle is not None:
            known = model.own_joints(oracle[1][:, h]) if isinstance(model, MovesArms) else None
            state = _overwrite(state, oracle[0][:, h], known, links)
        states.append(state)
    return stack(states + states[-1:] * (actions.shape[1] - steps), 1)


def _overwrite(state: State, truth: Tensor, joints: Tensor | None, links: Tensor) -> State:
    poses = torch.where(links[:, None, None], truth, state.poses())
    frames = torch.cat([poses.unsqueeze(1), state.history()[:, 1:]], 1)
    if isinstance(state, RigidState):
        return replace(state, frames=frames, joints=None if state.joints is None else joints)
    rigid = RigidState(state.layout, state.clouds, frames)
    assert isinstance(state, PointState)
    kept = torch.as_tensor(links.numpy()[state.layout.ids])[:, None]
    points = torch.where(kept, rigid.points(), state.points())
    return replace(state, frames=torch.cat([points.unsqueeze(1), state.frames[:, 1:]], 1))


def _joined(chunks: list[State]) -> State:
    parts = iter(zip(*(c.tensors for c in chunks), strict=True))
    return chunks[0].map(lambda _: torch.cat(next(parts)))


def position_errors(rollouts: Rollouts, entity: int) -> Tensor:
    """Distance (M, H) in metres between predicted and true origin of an entity; NaN past an episode's end."""
    gap = (rollouts.poses - rollouts.truth)[:, :, entity, :3, 3].norm(dim=-1)
    return gap.masked_fill(~rollouts.mask, torch.nan)


def rotation_errors(rollouts: Rollouts, entity: int) -> Tensor:
    """Angle (M, H) in degrees between predicted and true orientation of an entity; NaN past an episode's end."""
    angle = rotation_angle(rollouts.poses[:, :, entity, :3, :3], rollouts.truth[:, :, entity, :3, :3])
    return torch.rad2deg(angle).masked_fill(~rollouts.mask, torch.nan)


def joint_errors(rollouts: Rollouts, entity: int) -> Tensor:
    """Distance (M, H) in millimetres, or degrees, between predicted and true position of an articulated entity's joint.

    NaN past an episode's end.
    """
    layout = rollouts.dataset.layout
    told, true = (joint_positions(layout, poses, entity) for poses in (rollouts.poses, rollouts.truth))
    gap = told - true
    if layout.entities[entity].joint.kind == "revolute":
        gap = torch.rad2deg(torch.remainder(gap + torch.pi, 2 * torch.pi) - torch.pi)
    else:
        gap = 1e3 * gap
    return gap.abs().masked_fill(~rollouts.mask, torch.nan)


@torch.no_grad()
def long_rollouts(model: WorldModel, dataset: Dataset, steps: int = 300, seed: int = 0) -> dict[str, Any]:
    """Rollouts from the initial scenes of the demonstrations in ``dataset``, before any clipping.

    Under zero actions a resting arm and an untouched object rest in the simulator too (its controller tracks the
    present pose), so that what moved is the error; fingers shut to the controller's zero.

    Returns:
        ``zero_actions_mm``: how far each entity but sliding links ends from its start, largest of all scenes.
        ``random_actions_m``: largest distance of any entity from the base under uniformly random actions.
        ``finite``: whether every pose was.
    """
    layout = dataset.layout
    episodes = dataset.of_kinds(DEMONSTRATIONS).episodes or dataset.episodes  # practice may start in mid-air
    start: State = model.prepare(batch_state([dataset.scene(e) for e in episodes]))
    generator = torch.Generator().manual_seed(seed)
    count, finite, far = len(episodes), True, 0.0
    still = wild = start
    for _ in range(steps):
        still = model.step(still, torch.zeros(count, model.action_size))
        noise = torch.rand(count, model.action_size, generator=generator)
        wild = model.step(wild, 2.0 * noise - 1.0)
        finite = finite and bool(torch.isfinite(still.frames).all() and torch.isfinite(wild.frames).all())
        far = max(far, float(wild.poses()[..., :3, 3].norm(dim=-1).max()))
    moved = (still.poses() - start.poses())[..., :3, 3].norm(dim=-1).amax(0) * 1e3
    gaps = {e.name: float(m) for e, m in zip(layout, moved, strict=True) if not e.joint.moves}
    return {"steps": steps, "zero_actions_mm": gaps, "random_actions_m": far, "finite": finite}


def validation_metrics(model: WorldModel, dataset: Dataset, seen: np.ndarray | None = None) -> dict[str, float]:
    """Cheap metrics for training: mean position errors of hand and objects, in millimetres, over whole rollouts.

    ``seen`` tells a model of partial clouds which points a camera sees (:func:`predict`).
    """
    out = {}
    rollouts = predict(model, dataset, start=None if seen is None else observed_start(dataset, seen))
    kinds = np.array([KINDS[e.kind] for e in rollouts.episodes])
    for name, wanted in (("demonstration", DEMONSTRATIONS), ("practice", ("practice",))):
        chosen = torch.as_tensor(np.isin(kinds, wanted))
        for i, entity in enumerate(dataset.layout):
            if not entity.joint.moves and chosen.any():
                out[f"{name}_{entity.name}_mm"] = float(position_errors(rollouts, i)[chosen].nanmean()) * 1e3
    return out
