from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.data import KINDS, Dataset
from pwm_gym.dynamics import build_model
from pwm_gym.errors import SceneError
from pwm_gym.evaluation import evaluate_rollouts, long_rollouts, predict, validation_metrics
from pwm_gym.evaluation.floors import chaos_floor, in_units_of_chaos, nudged, sampling_floor
from pwm_gym.evaluation.rollouts import OBSERVED, Rollouts, at_steps, joint_errors, position_errors, rotation_errors
from pwm_gym.robots import Control
from pwm_gym.scene import (
    Joint,
    Layout,
    PointState,
    RigidState,
    Scene,
    batch_state,
    joint_positions,
    sample_clouds,
)
from pwm_gym.scene.se3 import matrix_from_pose7, pose7_from_matrix, rotation_from_vector
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
HAND, CUBE = TASK.layout.index("hand"), TASK.layout.index("cube")


@pytest.fixture(scope="module")
def dataset(train_split):
    """Two episodes of each kind, with few points, so that scoring is quick."""
    layout = TASK.layout.truncate(40)
    assets = {e.name: train_split.assets[e.name][: e.points] for e in layout}
    return Dataset("PickCube", layout, assets, train_split.episodes[:2] + train_split.episodes[4:6])


class Replay:
    """A world model that knows the data set by heart."""

    action_size = 7

    def __init__(self, dataset, form=lambda s: s, error=0.0):
        self.layout, self.prepare, self._error = dataset.layout, form, error
        longest = max(len(e) for e in dataset.episodes)
        index = np.arange(OBSERVED, longest + 1)
        poses = np.stack([e.poses[np.minimum(index, len(e))] for e in dataset.episodes])
        self._truth = matrix_from_pose7(torch.as_tensor(poses, dtype=torch.float64)).float()  # (M, H, E, 4, 4)
        self.actions = []

    def step(self, state, action):
        poses = self._truth[:, len(self.actions)].clone()
        poses[..., 2, 3] += self._error
        self.actions.append(action)
        if isinstance(state, RigidState):
            return state.advance(poses)
        return state.advance(RigidState(state.layout, state.clouds, poses[:, None].expand(-1, 3, -1, -1, -1)).points())


def test_three_clouds_are_observed_and_the_rest_predicted(dataset):
    rollouts = predict(Replay(dataset), dataset)
    assert rollouts.lengths.tolist() == [len(e) - 2 for e in dataset.episodes]
    assert rollouts.poses.shape[:2] == (4, rollouts.lengths.max())
    assert rollouts.mask.sum(1).tolist() == rollouts.lengths.tolist()


def test_the_model_gets_the_actions_that_were_made(dataset):
    model = Replay(dataset)
    predict(model, dataset)
    for m, episode in enumerate(dataset.episodes):
        given = torch.stack(model.actions, 1)[m, : len(episode) - 2]
        np.testing.assert_array_equal(given, episode.actions[2:])


def test_the_order_of_the_episodes_is_kept(dataset, cut, monkeypatch):
    """They are rolled out by their length, each batch as far as its longest one."""
    episodes = [cut(e, n) for e, n in zip(dataset.episodes, (9, 5, 12, 7), strict=True)]
    steps, model = [], build_model("commanded", TASK.layout, TASK.control)
    monkeypatch.setattr(model, "step", lambda *a, step=model.step: steps.append(len(a[1])) or step(*a))
    monkeypatch.setattr("pwm_gym.evaluation.rollouts._CHUNK", 2)
    there, back = (predict(model, replace(dataset, episodes=tuple(e))) for e in (episodes, episodes[::-1]))
    assert there.lengths.tolist() == [7, 3, 10, 5] and steps == [2] * (5 + 10) * 2
    torch.testing.assert_close(there.poses, back.poses.flip(0))
    monkeypatch.setattr("pwm_gym.evaluation.rollouts._CHUNK", 128)
    torch.testing.assert_close(predict(model, replace(dataset, episodes=tuple(episodes))).poses[2], there.poses[2])


@pytest.mark.parametrize("rigid", [False, True])
def test_a_model_of_points_begins_with_as_many_as_it_was_trained_to_move(dataset, cut, rigid):
    config = {"width": 8, "neighbours": 3, "points": 6, "rigid": rigid}
    model = build_model("gbnd", TASK.layout, TASK.control, config)
    rollouts = predict(model.eval(), replace(dataset, episodes=(cut(dataset.episodes[0], 4),)))
    assert rollouts.states.layout == (dataset.layout if rigid else dataset.layout.truncate(6))


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
def test_a_perfect_model_has_no_error(dataset, form):
    rollouts = predict(Replay(dataset, form), dataset)
    for entity in range(4):
        position, rotation = position_errors(rollouts, entity), rotation_errors(rollouts, entity)
        assert position.nan_to_num().max() < 1e-5
        assert rotation.nan_to_num().max() < 0.2  # degrees; of registration in single precision
        assert (position.isnan() == ~rollouts.mask).all()


def test_errors_are_the_distance_from_the_truth(dataset):
    rollouts = predict(Replay(dataset, error=0.01), dataset)
    error = position_errors(rollouts, CUBE)[rollouts.mask]
    torch.testing.assert_close(error, torch.full_like(error, 0.01), atol=1e-6, rtol=0)


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
def test_an_oracle_effector_is_the_truth_exactly(dataset, form):
    rollouts = predict(Replay(dataset, form, error=0.01), dataset, oracle_effector=True)
    truth = predict(Replay(dataset), dataset).states
    links = slice(0, dataset.layout["cube"].start)
    points, expected = rollouts.states.points(), truth.points()
    torch.testing.assert_close(points[:, :, links], expected[:, :, links], atol=1e-6, rtol=0)
    lift = (points - expected)[:, :, dataset.layout["cube"].slice, 2]
    torch.testing.assert_close(lift, torch.full_like(lift, 0.01), atol=1e-5, rtol=0)


def test_the_table_of_a_perfect_model(dataset):
    table = evaluate_rollouts(Replay(dataset), TASK, dataset, progress=False)
    kinds = [KINDS[e.kind] for e in dataset.episodes]
    assert table["practice"]["episodes"] == kinds.count("practice") == 2
    assert table["all"]["episodes"] == 2
    for row in table.values():
        assert row["chamfer_l1"] < 1e-6 and row["chamfer_l2"] < 1e-6 and row["chamfer_l1_entity_mean"] < 1e-6
        assert row["reward_correlation"] == pytest.approx(row["reward_correlation_ceiling"], abs=1e-6)
        assert row["entities"]["cube"]["position_mm"]["10"]["mean"] < 0.01


def test_the_table_of_a_known_error(dataset):
    """Everything 3 mm too high: for points so far apart, that is the Chamfer distance, or a little less."""
    row = evaluate_rollouts(Replay(dataset, error=0.003), TASK, dataset, progress=False)["practice"]
    assert 0.002 < row["chamfer_l1"] <= 0.003 + 1e-6
    assert row["chamfer_l2"] <= row["chamfer_l1"] + 1e-6
    for name in dataset.layout.names:
        for step in ("10", "30", "60", "half", "last"):
            assert row["entities"][name]["position_mm"][step]["mean"] == pytest.approx(3.0, abs=0.01)
    assert len(row["chamfer_l1_by_step"]) == 78


def cut(episode, steps):
    changes = {n: getattr(episode, n)[:steps] for n in ("actions", "rewards", "success", "grasped")}
    return replace(episode, poses=episode.poses[: steps + 1], joints=episode.joints[: steps + 1], **changes)


def test_trajectories_shorter_than_a_step_are_left_out_and_counted(dataset):
    practice = dataset.of_kinds(("practice",)).episodes
    short = replace(dataset, episodes=(cut(practice[0], 31), practice[1], cut(practice[1], 8)))
    row = evaluate_rollouts(Replay(short, error=0.001), TASK, short, progress=False)["practice"]
    position = row["entities"]["cube"]["position_mm"]
    assert {k: v["episodes"] for k, v in position.items()} == {"10": 2, "30": 1, "60": 1, "half": 3, "last": 3}
    assert row["mean_steps"] == pytest.approx((29 + 78 + 6) / 3)


def test_a_data_set_of_short_trajectories_alone_has_its_table(dataset):
    practice = dataset.of_kinds(("practice",)).episodes
    short = replace(dataset, episodes=(cut(practice[0], 14),))
    row = evaluate_rollouts(Replay(short, error=0.001), TASK, short, progress=False)["practice"]
    assert set(row["entities"]["cube"]["position_mm"]) == {"10", "half", "last"}


def test_errors_are_told_at_steps_that_episodes_reach_at_half_of_each_and_at_its_end():
    errors = np.arange(1.0, 41.0)[None].repeat(3, 0)
    told = at_steps(errors, np.array([40, 13, 1]))
    assert {k: v["episodes"] for k, v in told.items()} == {"10": 2, "30": 1, "half": 3, "last": 3}
    assert told["half"] == {"mean": (20 + 7 + 1) / 3, "median": 7.0, "episodes": 3}
    assert told["last"]["mean"] == (40 + 13 + 1) / 3


def test_a_model_that_blows_up_is_counted_not_hidden(dataset):
    row = evaluate_rollouts(Replay(dataset, error=float("nan")), TASK, dataset, progress=False)["practice"]
    assert row["chamfer_l1"] == np.inf


def test_validation_metrics_name_kinds_and_entities(dataset):
    metrics = validation_metrics(build_model("still", dataset.layout, Control()), dataset)
    assert set(metrics) == {f"{k}_{e}_mm" for k in ("demonstration", "practice") for e in ("hand", "cube")}
    rollouts = predict(build_model("still", dataset.layout, Control()), dataset.of_kinds(("practice",)))
    expected = 1e3 * position_errors(rollouts, HAND).nanmean().item()
    assert metrics["practice_hand_mm"] == pytest.approx(expected) and expected > 10


def test_long_rollouts_of_a_still_world(dataset):
    out = long_rollouts(build_model("still", dataset.layout, Control()), dataset, steps=5)
    assert out["zero_actions_mm"] == {"hand": 0.0, "cube": 0.0}
    assert out["finite"] and 0.5 < out["random_actions_m"] < 1.0 and out["steps"] == 5


def test_long_rollouts_start_where_demonstrations_do(train_split, monkeypatch):
    model, started = build_model("still", train_split.layout, Control()), []
    prepare = model.prepare
    monkeypatch.setattr(model, "prepare", lambda state: started.append(state.batch) or prepare(state))
    long_rollouts(model, train_split, steps=1)
    assert started == [(4,)] and len(train_split.episodes) == 8  # practice may start in mid-air


def test_the_sampling_floor(train_split, simulator):
    assert sampling_floor(train_split, lambda e: train_split.scene(e).clouds)["chamfer_l1"] == 0
    fresh = sample_clouds(simulator.meshes(), train_split.layout, seed=1000)
    floor = sampling_floor(train_split, lambda e: fresh)
    assert 0.002 < floor["chamfer_l2"] < floor["chamfer_l1"] < 0.008


def test_the_chaos_floor(train_split, simulator):
    practice = train_split.of_kinds(("practice",)).episodes[:1]
    floor = chaos_floor(simulator, TASK, replace(train_split, episodes=practice), progress=False)
    assert 1e-5 < floor["chamfer_l1"] < 0.02
    cube = floor["objects"]["cube"]
    assert floor["chamfer_l1"] == cube["chamfer_l1"] and cube["position_mm"].keys() == {
        "10",
        "30",
        "60",
        "half",
        "last",
    }
    assert 0.1 < cube["position_mm"]["last"]["mean"] < 300


def test_errors_in_units_of_chaos():
    errors = {"10": {"mean": 3.0}, "30": {"mean": 8.0}, "last": {"mean": 6.0}}
    chaos = {"10": {"mean": 1.5}, "last": {"mean": 12.0}}
    assert in_units_of_chaos(errors, chaos) == {"10": 2.0, "last": 0.5}


ARTICULATED = Layout.build(
    [("hand", 4), ("cabinet", 5), ("drawer", 5), ("lid", 5), ("cube", 4)],
    driven=("hand",),
    joints={
        "cabinet": Joint("fixed"),
        "drawer": Joint("prismatic", "cabinet", origin=(0.1, 0, 0, 0.5, 0.5, 0.5, 0.5), axis=(0, 0, 1), upper=0.2),
        "lid": Joint("revolute", "cabinet", origin=(0, 0.2, 0, 1, 0, 0, 0), axis=(0, 1, 0), lower=-2.0, upper=0.5),
    },
)


def opened(drawer, lid):
    """Poses (E, 4, 4) of a cabinet that stands askew."""
    poses = torch.eye(4).repeat(5, 1, 1)
    poses[1] = matrix_from_pose7(torch.tensor([0.3, -0.2, 0.1, 0.8, 0.0, 0.0, 0.6]))
    slide, turn = torch.eye(4), torch.eye(4)
    slide[2, 3] = drawer
    turn[:3, :3] = rotation_from_vector(torch.tensor([0.0, lid, 0.0]))
    for i, moved in ((2, slide), (3, turn)):
        poses[i] = poses[1] @ matrix_from_pose7(torch.tensor(ARTICULATED.entities[i].joint.origin)) @ moved
    return poses


def test_positions_of_joints_are_read_off_poses():
    poses = torch.stack([opened(0.05, 0.3), opened(0.15, -1.9)])
    torch.testing.assert_close(joint_positions(ARTICULATED, poses, 2), torch.tensor([0.05, 0.15]))
    torch.testing.assert_close(joint_positions(ARTICULATED, poses, 3), torch.tensor([0.3, -1.9]))


@pytest.mark.parametrize(
    ("drawer", "lid", "told"),
    [
        (0.3, 0.4, r"the joint of 'drawer' is at 0\.3000; expected 0\.0000 to 0\.2000"),
        (-0.1, 0.4, r"the joint of 'drawer' is at -0\.1000; expected 0\.0000"),
        (0.1, 2.0, r"the joint of 'lid' is at 2\.0000; expected -2\.0000 to 0\.5000"),
    ],
)
def test_scenes_whose_parts_are_beyond_their_limits_are_refused(drawer, lid, told):
    def scene(drawer, lid):
        pose = pose7_from_matrix(opened(drawer, lid).double()).numpy()
        return Scene(
            "made", ARTICULATED, np.zeros((ARTICULATED.points, 3), np.float32), np.stack([pose] * 3), np.zeros(0)
        )

    assert scene(0.205, 0.4).validate("made", ARTICULATED, 0)  # a spring at its end
    with pytest.raises(SceneError, match=told):
        scene(drawer, lid).validate("made", ARTICULATED, 0)


@pytest.mark.parametrize("entity", ["drawer", "lid"])
def test_parts_are_nudged_along_their_joint(entity):
    i = ARTICULATED.index(entity)
    clouds = np.random.default_rng(0).normal(size=(ARTICULATED.points, 3)).astype(np.float32)
    pose = pose7_from_matrix(opened(0.19, 0.4).double()).numpy()
    scene = Scene("made", ARTICULATED, clouds, np.repeat(pose[None], 3, 0), np.zeros(0))
    moved = nudged(scene, i)
    before, after = (joint_positions(ARTICULATED, batch_state([s]).poses(), i) for s in (scene, moved))
    assert after < before  # away from the near limit
    points = [batch_state([s]).points()[0, ARTICULATED[entity].slice] for s in (scene, moved)]
    assert (points[1] - points[0]).norm(dim=1).max() == pytest.approx(5e-4, rel=0.02)
    others = [k for k in range(5) if k != i]
    np.testing.assert_array_equal(moved.poses[:, others], scene.poses[:, others])


def test_a_table_tells_of_every_object_and_joint():
    """Errors of joints stand beside those of poses, in millimetres or degrees."""
    true, told = opened(0.05, 0.3), opened(0.08, 0.3 + np.deg2rad(10.0))
    truth, poses = (x.expand(2, 12, -1, -1, -1) for x in (true, told))
    data = Dataset.__new__(Dataset)
    object.__setattr__(data, "layout", ARTICULATED)
    rollouts = Rollouts(data, (), poses, truth, torch.empty(0), torch.empty(0), None, np.array([12, 7]))
    drawer, lid = (joint_errors(rollouts, ARTICULATED.index(n)) for n in ("drawer", "lid"))
    assert (drawer.isnan() == ~rollouts.mask).all()
    torch.testing.assert_close(drawer[rollouts.mask], torch.full((19,), 30.0), atol=1e-2, rtol=0)
    torch.testing.assert_close(lid[rollouts.mask], torch.full((19,), 10.0), atol=1e-2, rtol=0)
