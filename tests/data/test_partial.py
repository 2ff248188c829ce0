from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.cameras.viewpoints import CAMERA
from pwm_gym.data.partial import PARTIAL_POINTS, PartialWindows, choose_visible, visibility
from pwm_gym.dynamics import build_model
from pwm_gym.errors import DatasetError
from pwm_gym.evaluation import evaluate_rollouts, predict
from pwm_gym.evaluation.rollouts import observed_start
from pwm_gym.robots import Control
from pwm_gym.scene.se3 import matrix_from_pose7
from pwm_gym.tasks import get_task
from pwm_gym.training.losses import TrainConfig, rollout_loss


@pytest.fixture(scope="module")
def meshes(sim):
    return lambda scene: sim.unwrapped.simulator.meshes()


@pytest.fixture(scope="module")
def seen(train_split, meshes):
    return visibility(train_split, meshes, progress=False)


def test_a_camera_sees_some_of_each_entity_and_never_its_back(train_split, seen):
    frames = sum(len(e) + 1 for e in train_split.episodes)
    assert seen.shape == (frames, 1200)
    for entity in train_split.layout:
        share = seen[:, entity.slice].mean()
        assert 0.1 < share < 0.7
    first = train_split.episodes[0]
    cube = train_split.layout["cube"]
    pose = matrix_from_pose7(torch.as_tensor(first.poses[0, 3])).numpy()
    cloud = train_split.assets["cube"]
    world = cloud @ pose[:3, :3].T + pose[:3, 3]
    normal = np.zeros_like(cloud)
    side = np.abs(cloud).argmax(1)
    normal[np.arange(300), side] = np.sign(cloud[np.arange(300), side])
    towards = ((CAMERA.pose[:3, 3] - world) * (normal @ pose[:3, :3].T)).sum(1)
    back = seen[0, cube.slice][towards < 0]
    assert len(back) > 50 and back.mean() < 0.1  # a few, at the edges


def test_the_answer_is_kept_in_a_file(train_split, seen, meshes, tmp_path):
    path = tmp_path / "seen.npz"
    few = replace(train_split, episodes=train_split.episodes[:1])
    made = visibility(few, meshes, cache=path, progress=False)
    np.testing.assert_array_equal(made, seen[: len(made)])
    np.testing.assert_array_equal(visibility(few, None, cache=path, progress=False), made)  # no mesh is needed
    with pytest.raises(DatasetError, match=rf"seen\.npz tells of {len(made)} frames"):
        visibility(train_split, None, cache=path, progress=False)


def test_visible_points_are_drawn_and_repeated_where_they_are_few():
    seen = torch.zeros(3, 10, dtype=torch.bool)
    seen[0, [2, 5, 7]] = True
    seen[1] = True
    index = choose_visible(seen, 6, torch.Generator().manual_seed(0))
    assert torch.equal(index[0].sort().values, torch.tensor([2, 2, 5, 5, 7, 7]))
    assert len(index[1].unique()) == 6
    assert len(index[2].unique()) == 6  # none is seen: all stand for it


def test_windows_follow_the_points_that_are_seen_at_their_beginning(train_split, seen):
    windows = PartialWindows(train_split, seen)
    batch = windows.sample(torch.Generator().manual_seed(0), 5, 3)
    n = 4 * PARTIAL_POINTS
    assert batch.clouds.shape == (5, n, 3) and batch.observed.shape == (5, 3, n, 3)
    state = batch.state()
    assert state.layout.points == n
    truth = state.advance(batch.following[:, 0]).points()
    gap = torch.cdist(batch.observed[:, 0], truth).amin(2)
    assert gap.mean() < 0.01  # the targets lie on the true surfaces, but not on the same points
    assert not torch.equal(batch.observed[:, 0], truth)
    again = windows.sample(torch.Generator().manual_seed(0), 5, 3)
    assert torch.equal(again.observed, batch.observed)


def test_the_hybrid_loss_needs_no_correspondences(train_split, seen):
    batch = PartialWindows(train_split, seen).sample(torch.Generator().manual_seed(0), 4, 2)
    config = TrainConfig(loss="hybrid", loss_scale=1.0, loss_points=PARTIAL_POINTS)
    still = build_model("still", train_split.layout, Control())
    loss = rollout_loss(still, batch, config)
    state = batch.state()
    expected = []
    for k in range(2):
        gaps = torch.cdist(state.points(), batch.observed[:, k])
        chamfer = 0.5 * (gaps.amin(2).mean(1) + gaps.amin(1).mean(1))
        expected.append(chamfer + torch.maximum(gaps.amin(2).amax(1), gaps.amin(1).amax(1)))
    torch.testing.assert_close(loss, torch.stack(expected).mean())
    order = torch.randperm(batch.observed.shape[2])
    shuffled = type(batch)(**{**vars(batch), "observed": batch.observed[:, :, order]})
    torch.testing.assert_close(rollout_loss(still, shuffled, config), loss)


def test_a_model_of_partial_clouds_is_scored_against_the_complete_truth(train_split, seen):
    still = build_model("still", train_split.layout, Control())
    start = observed_start(train_split, seen)
    rollouts = predict(still, train_split, start=start)
    assert rollouts.states.layout.points == 4 * PARTIAL_POINTS
    partial = evaluate_rollouts(still, get_task("PickCube"), train_split, every=20, progress=False, start=start)
    complete = evaluate_rollouts(still, get_task("PickCube"), train_split, every=20, progress=False)
    for split in complete:
        assert partial[split]["chamfer_l1"] > complete[split]["chamfer_l1"]
        assert partial[split]["entities"] == complete[split]["entities"]
