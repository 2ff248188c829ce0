from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.data import Dataset, Episode
from pwm_gym.dynamics import build_model
from pwm_gym.evaluation.onsets import find_onsets, onset_errors, onset_floor
from pwm_gym.robots import Control
from pwm_gym.scene import Joint, Layout, PointState, Scene, Support
from pwm_gym.tasks import get_task

SIDE = 0.04
FINGER = Joint("prismatic", parent="hand", upper=0.04)
LAYOUT = Layout.build(
    [(n, 216) for n in ("hand", "left", "right", "cube_a", "cube_b")],
    driven=("hand", "left", "right"),
    joints={"left": FINGER, "right": FINGER},
    supports=(Support.ground(),),
)
FAR = {"hand": (0.0, 0.0, 0.5), "left": (0.0, 0.1, 0.45), "right": (0.0, -0.1, 0.45)}
STEP = 0.004  # metres
X, Y, Z = np.eye(3) * STEP


def cubes():
    """Points on the surface of a cube, the same for every entity."""
    axis = np.linspace(-SIDE / 2, SIDE / 2, 8)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    surface = grid[(np.abs(grid) == SIDE / 2).any(1)]
    return np.tile(surface[np.linspace(0, len(surface) - 1, 216).round().astype(int)], (len(LAYOUT), 1)).astype("f4")


class Synthetic(Dataset):
    """Episodes whose clouds are all of one shape, whatever the data set's fields are called."""

    def scene(self, episode, step=0):
        frames = [max(step - k, 0) for k in range(3)]
        return Scene(self.task, self.layout, cubes(), episode.poses[frames].astype(float), episode.goal)


def dataset(*episodes):
    made = object.__new__(Synthetic)
    for name, value in {"task": "made", "layout": LAYOUT, "episodes": tuple(episodes)}.items():
        object.__setattr__(made, name, value)
    return made


def episode(places, motions, rest=4):
    """Entities that stand at ``places``, then all move as ``motions`` say for three steps."""
    start = {**FAR, "cube_a": (0.3, 0.0, SIDE / 2), "cube_b": (-0.3, 0.0, SIDE / 2), **places}
    frames = []
    for step in range(rest + 4):
        made = np.zeros((len(LAYOUT), 7), np.float32)
        made[:, 3] = 1.0
        for i, name in enumerate(LAYOUT.names):
            made[i, :3] = np.asarray(start[name]) + max(0, step - rest) * np.asarray(motions.get(name, (0, 0, 0)))
        frames.append(made)
    steps = len(frames) - 1
    return Episode(
        poses=np.stack(frames),
        joints=np.zeros((steps + 1, 2, 9), np.float32),
        actions=np.zeros((steps, 7), np.float32),
        rewards=np.zeros(steps, np.float32),
        success=np.zeros(steps, bool),
        grasped=np.zeros(steps, bool),
        goal=np.zeros(0, np.float32),
        kind=0,
        seed=0,
    )


UP = 0.3  # height of things in mid-air
CASES = {
    "a finger pushes": (
        {"left": (0.3 - SIDE, 0.0, SIDE / 2)},
        {"left": X, "cube_a": X},
        ["pushed by the robot"],
    ),
    "a cube pushes a cube": (
        {"left": (0.3 - SIDE, 0.0, SIDE / 2), "cube_b": (0.3 + SIDE, 0.0, SIDE / 2)},
        {"left": X, "cube_a": X, "cube_b": X},
        ["pushed by the robot", "pushed by an object"],
    ),
    "fingers open and the cube falls": (
        {"hand": (0, 0, UP + 0.1), "left": (0, SIDE, UP), "right": (0, -SIDE, UP), "cube_a": (0, 0, UP)},
        {"left": Y, "right": -Y, "cube_a": -Z},
        ["released"],
    ),
    "the hand draws away and the cube falls": (
        {"hand": (0, 0, UP + SIDE), "cube_a": (0, 0, UP)},
        {"hand": Z, "cube_a": -Z},
        ["released"],
    ),
    "the cube below is pulled away": (
        {"left": (0.3 - SIDE, 0, 0.0), "cube_b": (0.3, 0.0, 1.5 * SIDE)},
        {"left": 3 * X, "cube_a": 3 * X, "cube_b": -Z},
        ["pushed by the robot", "unsupported"],
    ),
    "a cube started in mid-air falls": ({"cube_a": (0.3, 0.0, UP)}, {"cube_a": -Z}, ["unsupported"]),
    "both are lifted": (
        {"left": (0.3, 0, -SIDE / 2), "cube_b": (0.3, 0.0, 1.5 * SIDE)},
        {"left": Z, "cube_a": Z, "cube_b": Z},
        ["pushed by the robot", "pushed by an object"],
    ),
    "a finger squeezes a cube out": (
        {"left": (0.3 - SIDE, 0.0, SIDE / 2)},
        {"left": -Z, "cube_a": X},
        ["pushed by the robot"],
    ),
    "nothing is near": ({}, {"cube_a": X}, ["other"]),
    "nothing moves enough": ({}, {"cube_a": 0.2 * X}, []),
    "the robot alone moves": ({}, {"hand": X, "left": X}, []),
}


@pytest.mark.parametrize("case", CASES)
def test_causes_of_synthetic_onsets(case):
    places, motions, causes = CASES[case]
    found = find_onsets(dataset(episode(places, motions)))
    assert [o.cause for o in found] == causes
    assert all(o.step == 4 for o in found)
    for onset in found:
        np.testing.assert_allclose(onset.way, motions[LAYOUT.names[onset.entity]], atol=1e-6)


def test_what_moves_already_does_not_begin():
    moving = episode({}, {"cube_a": X}, rest=0)
    assert find_onsets(dataset(moving)) == []
    slow = replace(moving, poses=moving.poses.copy())
    slow.poses[0, 3, 0] += 0.7 * STEP  # moves by 1.2 mm before
    assert find_onsets(dataset(slow)) == []


class Shift:
    """A model that moves cube_a along x."""

    def __init__(self, length, form=lambda s: s):
        self.layout, self.action_size, self.prepare, self.length, self.batches = LAYOUT, 7, form, length, []

    def step(self, state, action):
        self.batches.append(len(action))
        poses = state.poses().clone()
        poses[:, 3, 0, 3] += self.length
        if isinstance(state, PointState):
            moved = state.points().clone()
            moved[:, LAYOUT["cube_a"].slice, 0] += self.length
            return state.advance(moved)
        return state.advance(poses)


PUSHES = dataset(*[episode(*CASES["a finger pushes"][:2]), episode(*CASES["nothing is near"][:2])] * 3)


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
@pytest.mark.parametrize(
    ("length", "median", "foreseen"), [(STEP, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6 * STEP, 0.4, 1.0), (-STEP, 2.0, 0.0)]
)
def test_the_error_is_told_in_units_of_the_true_way(length, median, foreseen, form):
    model = Shift(length, form)
    out = onset_errors(model, PUSHES)
    assert model.batches == [6]  # one step of all
    assert out["count"] == 6 and out["median"] == pytest.approx(median, abs=2e-3) and out["foreseen"] == foreseen
    assert {k: v["count"] for k, v in out["causes"].items()} == {"pushed by the robot": 3, "other": 3}
    assert out["objects"]["cube_a"]["median"] == pytest.approx(median, abs=2e-3)


def test_a_model_that_blows_up_foresees_nothing():
    out = onset_errors(Shift(float("nan")), PUSHES)
    assert out["median"] == np.inf and out["foreseen"] == 0.0


def test_a_motion_aside_is_not_foreseen():
    aside = episode({}, {"cube_a": Y})
    assert onset_errors(Shift(STEP), dataset(aside))["foreseen"] == 0.0


def test_without_onsets_there_is_no_figure():
    assert onset_errors(Shift(0.0), dataset(episode({}, {}))) is None


def test_onsets_of_recorded_episodes(train_split):
    task = get_task("PickCube")
    found = find_onsets(train_split)
    assert found and {o.cause for o in found} <= {"pushed by the robot", "released", "unsupported"}
    out = onset_errors(build_model("still", train_split.layout, Control()), train_split, found)
    assert out["median"] == pytest.approx(1.0, abs=1e-3) and out["foreseen"] == 0.0
    assert torch.isfinite(torch.tensor(out["median"])) and out["objects"].keys() == {"cube"}
    assert task.layout.names == train_split.layout.names


def test_the_floor_of_onsets_is_far_below_a_still_model(train_split, simulator):
    floor = onset_floor(simulator, train_split)
    assert floor["median"] < 0.6 and floor["foreseen"] > 0.6
