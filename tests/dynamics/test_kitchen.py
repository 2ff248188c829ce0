"""What the shipped checkpoint ``kitchen`` foresees of a task that no training of it saw."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.dynamics import load_checkpoint, resolve
from pwm_gym.robots.panda import PANDA
from pwm_gym.scene import batch_state
from pwm_gym.scene.cloud import reordered
from pwm_gym.scene.se3 import pose7_from_matrix
from pwm_gym.skills import OpenDrawer, servo
from pwm_gym.tasks import get_task

TASK = get_task("CoffeePreparation")
CABINET, DRAWER = (TASK.layout.index(name) for name in ("cabinet", "drawer"))
STEPS, SPEED = 60, 0.025


@pytest.fixture(scope="module")
def checkpoint():
    return load_checkpoint(resolve("kitchen", TASK.name))


@pytest.mark.parametrize("start", [None, 3, 300, 1000])
def test_a_drawer_is_hooked_open_whatever_points_of_it_are_read(checkpoint, start):
    state = batch_state([checkpoint.bank(TASK.name).scene(0)])
    if start is not None:
        clouds = [reordered(state.clouds[0, e.slice].numpy(), start % e.points, 256) for e in TASK.layout]
        state = replace(state, clouds=torch.as_tensor(np.concatenate(clouds))[None])
    state, model, openings = checkpoint.model.prepare(state), checkpoint.model, []
    with torch.no_grad():
        for _ in range(STEPS):
            poses = pose7_from_matrix(state.poses()[0]).numpy()
            drawer = OpenDrawer(poses, poses[CABINET], poses[DRAWER], SPEED, hooked=True)
            openings.append(drawer.opening)
            action = drawer.act()
            if action is None:
                break
            state = model.step(state, torch.as_tensor(action, dtype=torch.float32)[None])
    assert openings[0] < 0.002 and max(openings) > 0.12


@pytest.mark.parametrize("scene", [0, 1])
def test_a_hand_comes_down_to_a_pod_in_a_drawer(checkpoint, scene):
    state = checkpoint.model.prepare(batch_state([checkpoint.bank(TASK.name).scene(scene)]))
    pod = TASK.layout.index("pod")
    for phase, steps in (("open", STEPS), ("up", 12), ("over", 25), ("down", 20)):
        for _ in range(steps):
            poses = pose7_from_matrix(state.poses()[0]).numpy()
            drawer = OpenDrawer(poses, poses[CABINET], poses[DRAWER], SPEED, hooked=True)
            tool = PANDA.tool(poses)
            side = np.cross([0.0, 0.0, 1.0], drawer.front)
            if phase == "open":
                action = drawer.act()
                if action is None:
                    break
            else:
                target = tool[:3] + [0.0, 0.0, 0.05] if phase == "up" else poses[pod, :3].copy()
                target[2] += 0.10 if phase == "over" else 0.0
                action = servo(PANDA, tool, target, side, SPEED, gripper=1.0)
            with torch.no_grad():
                state = checkpoint.model.step(state, torch.as_tensor(action, dtype=torch.float32)[None])
    poses = pose7_from_matrix(state.poses()[0]).numpy()
    np.testing.assert_allclose(PANDA.tool(poses)[:3], poses[pod, :3], atol=0.012)
    assert poses[pod, 2] < poses[CABINET, 2]  # still in the drawer
