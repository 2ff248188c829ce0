"""Scenes of MugCleanup whose drawer is where a test wants it."""

from dataclasses import replace

import numpy as np

from pwm_gym.scene import Scene
from pwm_gym.scene.poses import compose
from pwm_gym.sim.cabinets import LOW_CABINET
from pwm_gym.sim.mugs import get_mug
from pwm_gym.tasks import get_task

TASK = get_task("MugCleanup")
CABINET_AT, DRAWER_AT, MUG_AT = (TASK.layout.index(name) for name in ("cabinet", "drawer", "mug"))


def scene_of(simulator, clouds=None):
    """The present scene, at rest, with canonical clouds (N, 3); zeros where they are of no account."""
    poses = np.stack([simulator.poses()] * 3)
    clouds = np.zeros((TASK.layout.points, 3), np.float32) if clouds is None else clouds
    return Scene(TASK.name, TASK.layout, clouds, poses, simulator.goal(), simulator.joints(), assets=simulator.assets())


def pulled(scene, opening, speed=0.0):
    """The scene with its drawer open by ``opening`` metres and opening by ``speed`` metres a step."""
    poses = scene.poses.copy()
    for k in range(3):
        slid = np.r_[*TASK.layout["drawer"].joint.origin[:3], 1, 0, 0, 0]
        slid[0] += opening - k * speed
        poses[k, DRAWER_AT] = compose(poses[k, CABINET_AT], slid)
    return replace(scene, poses=poses)


def put_in(scene):
    """The scene with its mug standing in the drawer."""
    poses, mug = scene.poses.copy(), get_mug(scene.assets[MUG_AT])
    place = np.r_[LOW_CABINET.place[:2], LOW_CABINET.place[2] + 0.5 * mug.height, 1, 0, 0, 0]
    poses[:, MUG_AT] = compose(poses[0, DRAWER_AT], place)
    return replace(scene, poses=poses)
