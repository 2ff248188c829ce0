"""Export to and import from Minari, Farama's format of offline data sets.

Observations are entity poses, joints and the goal, not points: with the canonical clouds they give the points, and a
data set stays small.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from pwm_gym.data.dataset import Dataset
from pwm_gym.data.episodes import KINDS, Episode
from pwm_gym.errors import DatasetError
from pwm_gym.tasks import get_task

__all__ = ["export_minari", "import_minari"]

_SPAN = 1e3  # Minari wants bounded spaces; nothing in a scene comes near


def export_minari(dataset: Dataset, dataset_id: str) -> Any:
    """Create the Minari data set ``dataset_id`` (such as ``"pwm/PickCube/expert-v0"``) of ``dataset``.

    Args:
        dataset: episodes of one split.
        dataset_id: Minari's name; Minari says where it stores it (``MINARI_DATASETS_PATH``).

    Returns:
        The ``minari.MinariDataset``.

    Raises:
        DatasetError: objects differ between episodes, which the format has no place for.
    """
    if len(dataset.combinations) > 1:
        found = len(dataset.combinations)
        raise DatasetError(
            f"the data set has {found} combinations of assets; expected the same objects in all episodes"
        )
    import minari
    from minari.data_collector import EpisodeBuffer

    task, first = get_task(dataset.task), dataset.episodes[0]
    shapes = {"poses": first.poses.shape[1:], "joints": first.joints.shape[1:], "goal": first.goal.shape}
    spaces: dict[str, gym.Space[Any]] = {
        k: gym.spaces.Box(-_SPAN, _SPAN, shape, np.float32) for k, shape in shapes.items()
    }
    buffers = [EpisodeBuffer(id=i, seed=e.seed, **_arrays(e)) for i, e in enumerate(dataset.episodes)]
    return minari.create_dataset_from_buffers(
        dataset_id,
        buffers,
        observation_space=gym.spaces.Dict(spaces),
        action_space=gym.spaces.Box(-1.0, 1.0, (task.action_size,), np.float32),
        algorithm_name="scripted expert",
        description=f"{task.name} of pwm_gym: {task.description} Poses (E, 7) of {', '.join(task.layout.names)}.",
    )


def _arrays(episode: Episode) -> dict[str, Any]:
    steps = len(episode)
    goals = np.repeat(episode.goal[None], steps + 1, 0)
    truncations = [False] * (steps - 1) + [not bool(episode.success[-1])]
    infos = {
        "success": np.concatenate([[False], episode.success]),
        "grasped": np.concatenate([[False], episode.grasped]),
        "kind": np.full(steps + 1, episode.kind),
        "seed": np.full(steps + 1, episode.seed),
        "switch": np.full(steps + 1, episode.switch),
    }
    return {
        "observations": {"poses": episode.poses, "joints": episode.joints, "goal": goals},
        "actions": episode.actions,
        "rewards": episode.rewards.tolist(),
        "terminations": [False] * (steps - 1) + [bool(episode.success[-1])],
        "truncations": truncations,
        "infos": infos,
    }


def import_minari(dataset_id: str, task: str, assets: Mapping[str, np.ndarray]) -> Dataset:
    """The episodes of a Minari data set that :func:`export_minari` wrote.

    Args:
        dataset_id: Minari's name.
        task: registered task.
        assets: asset -> canonical points (n, 3), metres.

    Raises:
        DatasetError: its observations are not those of an export.
    """
    import minari

    source = minari.load_dataset(dataset_id)
    space = source.spec.observation_space
    if not isinstance(space, gym.spaces.Dict) or set(space) != {"poses", "joints", "goal"}:
        raise DatasetError(f"{dataset_id} has observations {space}; expected a Dict of poses, joints and goal")
    episodes = tuple(_episode(data) for data in source.iterate_episodes())
    return Dataset(task, get_task(task).layout, assets, episodes)


def _episode(data: Any) -> Episode:
    infos = data.infos
    kind = int(infos["kind"][0])
    if not 0 <= kind < len(KINDS):
        raise DatasetError(f"episode {data.id} has kind {kind}; expected 0 to {len(KINDS) - 1}")
    return Episode(
        poses=np.asarray(data.observations["poses"], np.float32),
        joints=np.asarray(data.observations["joints"], np.float32),
        actions=np.asarray(data.actions, np.float32),
        rewards=np.asarray(data.rewards, np.float32),
        success=np.asarray(infos["success"][1:], bool),
        grasped=np.asarray(infos["grasped"][1:], bool),
        goal=np.asarray(data.observations["goal"][0], np.float32),
        kind=kind,
        seed=int(infos["seed"][0]),
        switch=int(infos["switch"][0]),
    )
