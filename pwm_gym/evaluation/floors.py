"""How small an error can be told from none: the floors that stand beside every table."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from pwm_gym.data.dataset import Dataset
from pwm_gym.evaluation.metrics import chamfer
from pwm_gym.scene import RigidState, Scene, batch_state
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["chaos_floor", "sampling_floor"]

_NUDGE = 0.0005  # metres


def sampling_floor(dataset: Dataset, clouds: np.ndarray) -> dict[str, float]:
    """Chamfer distance in metres of the same poses with freshly sampled points (N, 3): what sampling alone costs."""
    rows = []
    for episode in dataset.episodes:
        state = batch_state([dataset.scene(episode, len(episode) // 2)])
        fresh = RigidState(dataset.layout, torch.as_tensor(clouds)[None], state.frames)
        a, b = state.points()[0].numpy(), fresh.points()[0].numpy()
        rows.append((chamfer(a, b), chamfer(a, b, order=2)))
    l1, l2 = np.mean(rows, 0)
    return {"chamfer_l1": float(l1), "chamfer_l2": float(l2)}


def chaos_floor(simulator: Simulator, task: Task, dataset: Dataset, progress: bool = True) -> dict[str, Any]:
    """The simulator rerun with the object moved by 0.5 mm: Chamfer L1 and the object's error at its end.

    Episodes are replayed with their recorded actions from their first scene.
    """
    index, rows = task.layout.index(task.objects[0]), []
    for episode in tqdm(dataset.episodes, disable=not progress, desc="chaos floor", leave=False):
        simulator.reset(episode.seed)
        scene = dataset.scene(episode)
        poses = scene.poses.copy()
        poses[:, index, 0] += _NUDGE
        simulator.restore(replace(scene, poses=poses))
        rows.append(_replay(simulator, dataset, scene, episode.actions, episode.poses, index))
    distances, errors = zip(*rows, strict=True)
    return {
        "chamfer_l1": float(np.mean(distances)),
        f"{task.objects[0]}_last_mm": {
            "mean": 1e3 * float(np.mean(errors)),
            "median": 1e3 * float(np.median(errors)),
        },
    }


def _replay(
    simulator: Simulator, dataset: Dataset, scene: Scene, actions: np.ndarray, truth: np.ndarray, index: int
) -> tuple[float, float]:
    """Mean Chamfer L1 over the steps, and the object's position error at the last."""
    distances = []
    for k, action in enumerate(actions):
        simulator.step(action)
        if k % 5 == 0:  # every fifth step is enough for a mean
            a, b = (
                batch_state([replace(scene, poses=np.repeat(p[None].astype(float), 3, 0))]).points()[0].numpy()
                for p in (simulator.poses(), truth[k + 1])
            )
            distances.append(chamfer(a, b))
    return float(np.mean(distances)), float(np.linalg.norm(simulator.poses()[index, :3] - truth[-1, index, :3]))
