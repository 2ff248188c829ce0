"""Initial scenes of a task from its simulator, for a checkpoint that was never trained on it."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from pwm_gym.dynamics import SceneBank
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import sample_clouds
from pwm_gym.seeds import seed_range
from pwm_gym.tasks import Task

__all__ = ["simulated_bank"]


def simulated_bank(task: Task, count: int, objects: str | None = None) -> SceneBank:
    """The first scenes of ``count`` episodes of the task's training seeds.

    Args:
        task: the task.
        count: scenes.
        objects: what episodes draw their objects from, as of :meth:`pwm_gym.tasks.Task.make_simulator`.

    Raises:
        PwmGymError: no scenes are asked for, or the task has no such objects.
    """
    if count < 1:
        raise PwmGymError(f"count={count}; expected at least 1")
    clouds: dict[tuple[str, ...], np.ndarray] = {}
    poses, goals, joints, combination = [], [], [], []
    with closing(task.make_simulator(objects)) as simulator:
        for seed in seed_range("train", count):
            simulator.reset(seed)
            assets = simulator.assets()
            if assets not in clouds:
                clouds[assets] = sample_clouds(simulator.meshes(), task.layout, task.cloud_seed)
            poses.append(simulator.poses())
            goals.append(simulator.goal())
            joints.append(simulator.joints()[0])
            combination.append([*clouds].index(assets))
    return SceneBank(
        task.name,
        task.layout,
        np.stack([*clouds.values()]).astype(np.float32),
        np.asarray(poses, np.float32),
        np.asarray(goals, np.float32),
        np.array(combination),
        tuple(clouds),
        np.asarray(joints, np.float32),
    )
