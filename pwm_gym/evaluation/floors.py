"""How small an error can be told from none: the floors that stand beside every table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from pwm_gym.data.dataset import Dataset
from pwm_gym.data.episodes import Episode
from pwm_gym.evaluation.joints import along_joint
from pwm_gym.evaluation.metrics import chamfer
from pwm_gym.evaluation.rollouts import OBSERVED, at_steps
from pwm_gym.scene import RigidState, Scene, batch_state
from pwm_gym.scene.se3 import matrix_from_pose7, pose7_from_matrix
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = ["chaos_floor", "in_units_of_chaos", "nudged", "sampling_floor"]

_NUDGE = 0.0005  # metres
_EVERY = 5  # steps between Chamfer distances: enough for a mean


def sampling_floor(dataset: Dataset, fresh: Callable[[Episode], np.ndarray]) -> dict[str, float]:
    """Chamfer distance in metres of the same poses with freshly sampled points: what sampling alone costs.

    Args:
        dataset: episodes; each is measured in its middle.
        fresh: an episode's canonical points (N, 3), sampled anew.
    """
    rows = []
    for episode in dataset.episodes:
        state = batch_state([dataset.scene(episode, len(episode) // 2)])
        other = RigidState(dataset.layout, torch.as_tensor(fresh(episode))[None], state.frames)
        a, b = state.points()[0].numpy(), other.points()[0].numpy()
        rows.append((chamfer(a, b), chamfer(a, b, order=2)))
    l1, l2 = np.mean(rows, 0)
    return {"chamfer_l1": float(l1), "chamfer_l2": float(l2)}


def chaos_floor(simulator: Simulator, task: Task, dataset: Dataset, progress: bool = True) -> dict[str, Any]:
    """The simulator rerun with one object moved by 0.5 mm, for each object apart.

    Episodes are replayed with their recorded actions from their first scene; steps count from the third, as those of
    rollouts do.

    Returns:
        "chamfer_l1": metres, mean over steps, episodes and objects. "objects": for each, how far it ends from where it
        was, "position_mm" at the steps of the table, and the "chamfer_l1" of the scene.
    """
    objects = {}
    for name in task.objects:
        entity = dataset.layout.index(name)
        distances, errors = [], []
        bar = tqdm(dataset.episodes, disable=not progress, desc=f"chaos floor of {name}", leave=False)
        for episode in bar:
            simulator.reset(episode.seed)
            scene = dataset.scene(episode)
            simulator.restore(nudged(scene, entity))
            distance, error = _replay(simulator, scene, episode, entity)
            distances.append(distance)
            errors.append(error[OBSERVED - 1 :])
        lengths = np.array([len(e) for e in errors])
        padded = np.full((len(errors), lengths.max()), np.nan)
        for row, error in zip(padded, errors, strict=True):
            row[: len(error)] = error
        objects[name] = {"chamfer_l1": float(np.mean(distances)), "position_mm": at_steps(1e3 * padded, lengths)}
    return {"chamfer_l1": float(np.mean([o["chamfer_l1"] for o in objects.values()])), "objects": objects}


def in_units_of_chaos(errors: dict[str, dict[str, float]], chaos: dict[str, dict[str, float]]) -> dict[str, float]:
    """Mean errors at the steps of the table over the chaos floor's at the same steps."""
    return {k: v["mean"] / max(chaos[k]["mean"], 1e-9) for k, v in errors.items() if k in chaos}


def nudged(scene: Scene, entity: int, distance: float = _NUDGE) -> Scene:
    """The same scene with one entity moved by ``distance`` metres: along x, or along its joint where it has one."""
    poses = scene.poses.copy()
    part = scene.layout.entities[entity]
    if part.articulated:
        cloud = torch.as_tensor(scene.clouds[part.slice], dtype=torch.float64)
        matrices = matrix_from_pose7(torch.as_tensor(poses, dtype=torch.float64))
        poses[:, entity] = pose7_from_matrix(along_joint(scene.layout, matrices, entity, distance, cloud)).numpy()
    else:
        poses[:, entity, 0] += distance
    return replace(scene, poses=poses)


def _replay(simulator: Simulator, scene: Scene, episode: Episode, entity: int) -> tuple[float, np.ndarray]:
    """Mean Chamfer L1 over the steps, and an entity's position error (T,) after each, metres."""
    distances, errors = [], []
    for k, action in enumerate(episode.actions):
        simulator.step(action)
        found, truth = simulator.poses(), episode.poses[k + 1]
        errors.append(float(np.linalg.norm(found[entity, :3] - truth[entity, :3])))
        if k % _EVERY == 0:
            a, b = (
                batch_state([replace(scene, poses=np.repeat(p[None].astype(float), 3, 0))]).points()[0].numpy()
                for p in (found, truth)
            )
            distances.append(chamfer(a, b))
    return float(np.mean(distances)), np.array(errors)
