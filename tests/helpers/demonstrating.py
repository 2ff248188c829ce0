"""What tests of long tasks share: the expert's episodes in the simulator."""

import numpy as np
import torch

from pwm_gym.costs import cost_info, get_grasp
from pwm_gym.scene import Scene, batch_state, sample_clouds


def steps_to_success(task, simulator, seed):
    """Expert's steps until the simulator calls it a success; one more than the task's limit if it never does."""
    simulator.reset(seed)
    expert, assets = task.expert(np.random.default_rng(seed)), simulator.assets()
    for step in range(1, task.max_episode_steps + 1):
        if simulator.step(expert.act(simulator.poses(), simulator.goal(), assets)).success:
            return step
    return task.max_episode_steps + 1


def demonstration(task, simulator, seed):
    """An expert's episode until 5 steps past success: scenes, what costs read of them, and outcomes."""
    simulator.reset(seed)
    expert, assets = task.expert(np.random.default_rng(seed)), simulator.assets()
    clouds = sample_clouds(simulator.meshes(), task.layout, task.cloud_seed)
    poses, scenes, actions, outcomes = [simulator.poses()] * 3, [], [], []
    while sum(o.success for o in outcomes) < 5 and len(outcomes) < task.max_episode_steps:
        actions.append(expert.act(simulator.poses(), simulator.goal(), assets))
        outcomes.append(simulator.step(actions[-1]))
        poses.insert(0, simulator.poses())
        last = np.stack(poses[:3])
        scenes.append(Scene(task.name, task.layout, clouds, last, simulator.goal(), simulator.joints(), assets=assets))
    goals = torch.zeros(len(scenes), 0)
    view = cost_info(batch_state(scenes), torch.as_tensor(np.array(actions)), goals, get_grasp(task.grasp))
    return scenes, view, outcomes
