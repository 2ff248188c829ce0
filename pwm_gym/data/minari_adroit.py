"""Demonstrations of Gymnasium-Robotics' Adroit environments in Minari's format, such as ``D4RL/door/human-v2``.

A data set holds observations and actions, no poses. An episode's first observation tells where everything is; from
there its actions are replayed in the task's own simulator, which gives poses, rewards and successes. An episode whose
replay strays from what was recorded is left out.

Sources of the format: ``_get_obs`` and ``set_env_state`` of Gymnasium-Robotics, and the scripts by which Farama made
its sets of D4RL's (``minari-dataset-generation-scripts``, ``scripts/adroit``). These reset the environment with the
option ``initial_state_dict``, which Minari keeps in an episode's metadata.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pwm_gym.data.dataset import SPLITS
from pwm_gym.data.episodes import KINDS, Episode
from pwm_gym.data.minari_store import read_episodes, write_folder
from pwm_gym.errors import DatasetError, PwmGymError
from pwm_gym.files import check_finite
from pwm_gym.scene import sample_clouds
from pwm_gym.seeds import RANGES
from pwm_gym.sim import SimOutcome
from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.adroit import AdroitWorld
from pwm_gym.sim.mujoco.adroit_starts import (
    JointState,
    correct_door,
    correct_relocate,
    start_door,
    start_relocate,
)
from pwm_gym.tasks import Task, get_task

__all__ = ["ENVIRONMENTS", "TOLERANCE", "environment_of", "import_adroit"]

TOLERANCE = 0.05
"""Metres and radians by which a replay may stray from its recording."""

_OBSERVED = 39  # components of an observation
_SHORTEST = 3  # steps, so that an episode has both velocities


@dataclass(frozen=True)
class _Environment:
    """How a data set of an environment is read."""

    task: str
    start: Callable[[AdroitWorld, np.ndarray, JointState | None], None]
    """(world, first observation, its joints): go there."""
    correct: Callable[[AdroitWorld, np.ndarray], None]
    """(world, observation after the step just made): go there."""
    continuous: int
    """Components of an observation that come before those which jump."""


ENVIRONMENTS: Mapping[str, _Environment] = {
    "AdroitHandDoor-v1": _Environment("AdroitHandDoor", start_door, correct_door, 38),
    "AdroitHandRelocate-v1": _Environment("AdroitHandRelocate", start_relocate, correct_relocate, _OBSERVED),
}
"""Gymnasium id -> how its data sets are read."""


def environment_of(source: Any) -> str:
    """Gymnasium id of the environment that a Minari data set names; "" where it names none."""
    return "" if source.env_spec is None else str(source.env_spec.id)


def import_adroit(
    source: Any,
    dataset_id: str,
    root: Path,
    task: str | None = None,
    tolerance: float = TOLERANCE,
    split_seed: int = 0,
    progress: bool = False,
    follow: bool = False,
) -> list[str]:
    """Replay a data set of one of :data:`ENVIRONMENTS`, and write what came of it.

    ``settings["replay"]`` of the written data set says how many episodes were recorded and how many were left out.

    Args:
        source: the ``minari.MinariDataset``.
        dataset_id: Minari's name of it.
        root: folder to fill.
        task: registered task that the data must be of; None takes what it is of.
        tolerance: metres and radians by which no component of an observation may stray at any step.
        split_seed: of the draw that parts episodes into training (eight tenths), validation and test.
        progress: whether to show a bar.
        follow: whether positions are put back to the recorded ones after each step, so that an episode strays only
            where a single step does.

    Returns:
        Splits that were written.

    Raises:
        DatasetError: it is of another task, its observations or actions have another form, or fewer than three episodes
            are left.
    """
    environment = ENVIRONMENTS[environment_of(source)]
    _check(source, dataset_id, environment, task, tolerance)
    known = get_task(environment.task)
    simulator: Any = known.make_simulator()  # a MujocoSimulator of an AdroitWorld
    try:
        episodes = _replayed(source, dataset_id, _Replay(environment, simulator, tolerance, follow), progress)
        clouds = _clouds(simulator, known)
    finally:
        simulator.close()
    kept = [episode for episode in episodes if episode is not None]
    _check_enough(kept, len(episodes), dataset_id, tolerance)
    replay = {
        "recorded": len(episodes),
        "left_out": len(episodes) - len(kept),
        "tolerance": tolerance,
        "split_seed": split_seed,
        "follow": follow,
    }
    settings = {"task": known.name, "imported": dataset_id, "replay": replay}
    by_split = _draw_splits(kept, split_seed)
    write_folder(root, by_split, clouds, settings, known.layout)
    return [*by_split]


def _check_enough(kept: Sequence[Episode], recorded: int, dataset_id: str, tolerance: float) -> None:
    """Raise :class:`DatasetError` where not every split would have an episode."""
    if len(kept) < len(SPLITS):
        raise DatasetError(
            f"{dataset_id!r}: {len(kept)} of {recorded} episodes replay within {tolerance} m and rad of what was "
            f"recorded; expected {len(SPLITS)} or more, one for each split"
        )


def _check(source: Any, dataset_id: str, environment: _Environment, task: str | None, tolerance: float) -> None:
    """Raise :class:`DatasetError` where a data set does not fit its environment, or what was asked for."""
    if task is not None and task != environment.task:
        raise DatasetError(f"{dataset_id!r} is a data set of task {environment.task!r}; expected {task!r}")
    if not tolerance > 0.0:
        raise DatasetError(f"tolerance={tolerance}; expected more than 0")
    observations, actions = source.spec.observation_space, source.spec.action_space
    if observations.shape != (_OBSERVED,):
        raise DatasetError(f"{dataset_id!r} has observations {observations}; expected a Box of shape {(_OBSERVED,)}")
    size = get_task(environment.task).action_size
    if actions.shape != (size,):
        raise DatasetError(
            f"{dataset_id!r} has actions of shape {actions.shape}; task {environment.task!r} expects {(size,)}"
        )


def _clouds(simulator: MujocoSimulator, task: Task) -> dict[str, np.ndarray]:
    """Canonical points (n, 3) of each asset, metres."""
    points = sample_clouds(simulator.meshes(), task.layout, task.cloud_seed)
    return {name: points[entity.slice] for name, entity in zip(simulator.assets(), task.layout, strict=True)}


def _draw_splits(episodes: Sequence[Episode], seed: int) -> dict[str, list[Episode]]:
    """Split -> its episodes: a tenth each for validation and test, at least one.

    Their seeds, by which data sets tell episodes apart, are the last ones of their split.
    """
    held_out = max(1, len(episodes) // 10)
    order = np.random.default_rng(seed).permutation(len(episodes))
    parts = np.split(order, [len(order) - 2 * held_out, len(order) - held_out])
    by_split = {}
    for split, part in zip(SPLITS, parts, strict=True):
        seeds = RANGES[split][-len(part) :]
        by_split[split] = [replace(episodes[k], seed=own) for k, own in zip(sorted(part), seeds, strict=True)]
    return by_split


def _replayed(source: Any, dataset_id: str, replay: _Replay, progress: bool) -> list[Episode | None]:
    """Each recorded episode; None where its replay strays."""
    from tqdm import tqdm

    found = []
    rows = read_episodes(source, dataset_id)
    for data in tqdm(rows, total=source.total_episodes, unit="episode", disable=not progress):
        try:
            recorded = _recorded(data, _metadata(source, data.id), replay.simulator)
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise DatasetError(f"{dataset_id!r}, episode {data.id}: {error}") from error
        found.append(replay(recorded))
    return found


# What was recorded ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Recorded:
    """An episode as its data set has it."""

    observations: np.ndarray
    """(T + 1, 39), metres and radians."""
    actions: np.ndarray
    """(T, A) float32 in [-1, 1]."""
    start: JointState | None
    """Joints at the first observation, where they are told."""


def _metadata(source: Any, episode: int) -> Mapping[str, Any]:
    """What Minari keeps of an episode beside its steps."""
    return next(iter(source.storage.get_episode_metadata([episode])))


def _recorded(data: Any, metadata: Mapping[str, Any], simulator: MujocoSimulator) -> _Recorded:
    """An episode in Minari's form.

    Raises:
        DatasetError: its arrays do not fit each other, or hold what is not finite.
    """
    observations = np.asarray(data.observations, np.float64)
    actions = np.asarray(data.actions, np.float32)
    steps = len(actions)
    if steps < _SHORTEST:
        raise DatasetError(f"it has {steps} steps; expected {_SHORTEST} or more")
    if observations.shape != (steps + 1, _OBSERVED):
        raise DatasetError(f"observations have shape {observations.shape}; expected {(steps + 1, _OBSERVED)}")
    if actions.shape != (steps, simulator.action_size):
        raise DatasetError(f"actions have shape {actions.shape}; expected {(steps, simulator.action_size)}")
    check_finite(observations, "observations", DatasetError)
    check_finite(actions, "actions", DatasetError)
    clipped = np.clip(actions, -1.0, 1.0)  # as the environment's step does
    return _Recorded(observations, clipped, _start(data.infos or {}, metadata, simulator))


def _start(infos: Mapping[str, Any], metadata: Mapping[str, Any], simulator: MujocoSimulator) -> JointState | None:
    """Joints at the first observation: of the state that the episode was reset to, or of ``infos``.

    Where door, ball and target are, the first observation alone decides: the ``infos`` of D4RL's sets of the ball
    repeat those of one episode.

    Raises:
        DatasetError: positions or velocities are missing, or not those of the model.
    """
    reset_to = (metadata.get("options") or {}).get("initial_state_dict") or {}
    told = [reset_to, _first(infos.get("state") or {}), _first(infos)]
    state = next((state for state in told if "qpos" in state or "qvel" in state), None)
    if state is None:
        return None
    model = simulator.model
    return JointState(_joint_values(state, "qpos", model.nq), _joint_values(state, "qvel", model.nv))


def _first(per_step: Mapping[str, Any]) -> dict[str, Any]:
    """Joints in the first row of what is told at every step."""
    return {name: per_step[name][0] for name in ("qpos", "qvel") if name in per_step}


def _joint_values(state: Mapping[str, Any], name: str, size: int) -> np.ndarray:
    """Values (size,) of a state."""
    if name not in state:
        raise DatasetError(f"its first state has {', '.join(sorted(state))} and no {name}; expected qpos and qvel")
    values = np.asarray(state[name], np.float64)
    if values.shape != (size,):
        raise DatasetError(f"{name} of its first state has shape {values.shape}; expected {(size,)}")
    check_finite(values, name, DatasetError)
    return values


# What comes of it -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Replay:
    """Runs recorded episodes in the task's own simulator."""

    environment: _Environment
    simulator: MujocoSimulator
    tolerance: float
    follow: bool

    @property
    def _world(self) -> Any:
        return self.simulator.world

    def __call__(self, recorded: _Recorded) -> Episode | None:
        """The episode; None where it strays from what was recorded."""
        simulator = self.simulator
        self.environment.start(self._world, recorded.observations[0], recorded.start)
        if self._strays(recorded.observations[0]):
            return None
        goal = simulator.goal()
        poses, joints, outcomes = [simulator.poses()], [simulator.joints()], []
        for action, observation in zip(recorded.actions, recorded.observations[1:], strict=True):
            try:
                outcomes.append(simulator.step(action))
            except PwmGymError:  # it diverged
                return None
            if self._strays(observation):
                return None
            if self.follow:
                self.environment.correct(self._world, observation)
                outcomes[-1] = simulator.outcome()
            poses.append(simulator.poses())
            joints.append(simulator.joints())
        return self._episode(recorded, goal, poses, joints, outcomes)

    def _strays(self, observation: np.ndarray) -> bool:
        """Whether the environment shows something else than an observation (39,)."""
        difference = np.abs(self._world.observation - observation)
        return bool(difference[: self.environment.continuous].max() > self.tolerance)

    def _episode(
        self,
        recorded: _Recorded,
        goal: np.ndarray,
        poses: list[np.ndarray],
        joints: list[np.ndarray],
        outcomes: list[SimOutcome],
    ) -> Episode:
        """What the simulator showed, as an expert's episode."""
        return Episode(
            poses=np.asarray(poses, np.float32),
            joints=np.asarray(joints, np.float32),
            actions=recorded.actions,
            rewards=np.array([outcome.reward for outcome in outcomes], np.float32),
            success=np.array([outcome.success for outcome in outcomes]),
            grasped=np.array([outcome.grasped for outcome in outcomes]),
            goal=goal,
            kind=KINDS.index("expert"),
            seed=0,  # given with its split
            assets=self.simulator.assets(),
        )
