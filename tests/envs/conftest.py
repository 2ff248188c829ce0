"""A toy task that differs from the suite's own: two arms with fingers, no goal, another block every other episode."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from pwm_gym.costs.registry import COSTS, GRASPS, SUCCESSES, Cost
from pwm_gym.dynamics import build_model
from pwm_gym.robots import Arm, Channel, Control, Robot
from pwm_gym.scene import Layout, Scene
from pwm_gym.sim import SimOutcome
from pwm_gym.tasks.registry import TASKS, Task

HANDS = ("left_hand", "right_hand")
BLOCKS = {"small_block": 0.04, "large_block": 0.08}
PLACES = {"left_hand": (0.5, 0.3, 0.3), "right_hand": (0.5, -0.3, 0.3), "block": (0.6, 0, 0.04), "ball": (0.8, 0, 0.03)}
LAYOUT = Layout.build([("left_hand", 40), ("right_hand", 40), ("block", 60), ("ball", 60)], driven=HANDS)


def _control():
    channels = []
    for arm in HANDS:
        at = channels[-1].stop if channels else 0
        channels += [
            Channel("translation", at, at + 3, 0.1, arm=arm),
            Channel("rotation", at + 3, at + 6, arm=arm),
            Channel("finger", at + 6, at + 12, rest=None, arm=arm),
        ]
    return Control(tuple(channels), tuple(Arm(name, name) for name in HANDS))


class ToySimulator:
    """Hands go where they are told, one centimetre a unit; nothing else moves."""

    action_size = 24

    def __init__(self):
        self.meshes_made, self.closed = 0, False
        self._block, self._poses = "small_block", np.zeros((4, 7))

    def meshes(self):
        self.meshes_made += 1
        hand = trimesh.creation.box((0.06, 0.06, 0.1))
        block = trimesh.creation.box([BLOCKS[self._block]] * 3)
        return {"left_hand": hand, "right_hand": hand, "block": block, "ball": trimesh.creation.icosphere(2, 0.03)}

    def reset(self, seed):
        self._block = sorted(BLOCKS)[seed % 2]
        self._poses = np.array([[*PLACES[name], 1, 0, 0, 0] for name in LAYOUT.names], np.float64)

    def restore(self, scene, rebuild=True):
        self._block, self._poses = scene.assets[2], scene.poses[0].copy()

    def step(self, action):
        self._poses[0, :3] += 0.01 * action[:3]
        self._poses[1, :3] += 0.01 * action[12:15]
        return self.outcome()

    def outcome(self):
        return SimOutcome(0.5, bool(self._poses[0, 2] > 0.4), False)

    def assets(self):
        return (*HANDS, self._block, "ball")

    def poses(self):
        return self._poses.copy()

    def goal(self):
        return np.zeros(0, np.float32)

    def joints(self):
        return np.zeros((2, 3), np.float32)

    def close(self):
        self.closed = True


def _reach(points, info):
    return (points["left_hand"].mean(-2) - points["block"].mean(-2)).norm(dim=-1)


class ToyBank:
    """Scenes of both blocks in turn."""

    def __len__(self):
        return 4

    def scene(self, index):
        clouds = np.random.default_rng(0).normal(0, 0.03, (LAYOUT.points, 3)).astype(np.float32)
        asset = sorted(BLOCKS)[index % 2]
        clouds[LAYOUT["block"].slice] *= 2.0 if asset == "large_block" else 1.0
        poses = np.array([[*PLACES[name], 1, 0, 0, 0] for name in LAYOUT.names], np.float64)
        poses[2, 0] += 0.01 * index
        assets = (*HANDS, asset, "ball")
        return Scene("Toy", LAYOUT, clouds, np.stack([poses] * 3), np.zeros(0, np.float32), assets=assets)


@pytest.fixture
def toy(monkeypatch):
    """The toy task, registered, with a world model in which nothing moves."""
    monkeypatch.setitem(COSTS, "toy", Cost("toy", {"reach": (1.0, _reach)}))
    monkeypatch.setitem(SUCCESSES, "toy", lambda points, info: points["left_hand"][..., 2].mean(-1) > 0.5)
    monkeypatch.setitem(GRASPS, "toy", lambda points, info: _reach(points, info) < 0.05)
    task = Task(
        name="Toy",
        description="Reach the block with either hand.",
        robot=Robot("two hands", {name: name for name in HANDS}, _control()),
        layout=LAYOUT,
        simulator=ToySimulator,
        expert=lambda rng: None,
        cost="toy",
        plan_cost="toy",
        success="toy",
        grasp="toy",
    )
    monkeypatch.setitem(TASKS, "Toy", task)
    model = build_model("still", LAYOUT, task.control)
    checkpoint = SimpleNamespace(
        model=model, bank=lambda task: ToyBank(), check_robot=lambda *_: None, check_joints=lambda *_: None
    )
    monkeypatch.setattr("pwm_gym.envs.model_vector_env.resolve", lambda *_: None)
    monkeypatch.setattr("pwm_gym.envs.model_vector_env.load_checkpoint", lambda *_: checkpoint)
    return task


@pytest.fixture
def clutter():
    """``clutter(scene, *names)``: the scene with further free entities, each a metre behind the one before."""

    def add(scene, *names):
        single = Layout.build([(name, 30) for name in names])
        clouds = np.random.default_rng(1).normal(0, 0.02, (single.points, 3)).astype(np.float32)
        poses = np.array([[-0.5, 0.2 * k, 0.02, 1, 0, 0, 0] for k in range(len(names))], np.float64)
        return Scene(
            scene.task,
            scene.layout.plus(single.entities),
            np.concatenate([scene.clouds, clouds]),
            np.concatenate([scene.poses, np.stack([poses] * 3)], 1),
            scene.goal,
            scene.joints,
            scene.last_action,
        )

    return add


@pytest.fixture
def sliding():
    """``sliding(model)``: the same world, in which everything moves 1 mm a step along x."""

    class Sliding:
        def __init__(self, model):
            self.links, self.action_size = model.links, model.action_size

        def prepare(self, state):
            return state

        def step(self, state, action):
            poses = state.poses().clone()
            poses[..., 0, 3] += 1e-3
            return state.advance(poses)

    def make(env):
        core = getattr(env.unwrapped, "vector", env.unwrapped)
        core.model = Sliding(core.model)
        if hasattr(env.unwrapped, "vector"):
            env.unwrapped.model = core.model
        return torch.tensor(1e-3)

    return make
