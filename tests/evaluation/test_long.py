import numpy as np
import pytest

from pwm_gym.dynamics import build_model
from pwm_gym.evaluation.long import error_curves, mixed_episodes
from pwm_gym.robots import Control
from pwm_gym.seeds import split_of
from pwm_gym.tasks import get_task
from pwm_gym.viewer import draw_quartiles

TASK = get_task("PickCube")


@pytest.fixture(scope="module")
def episodes(sim, train_split):
    return mixed_episodes(sim.unwrapped.simulator, TASK, train_split, count=2, steps=70, progress=False)


def test_experts_and_random_actions_take_turns(episodes):
    for episode in episodes.episodes:
        assert len(episode) == 72 and split_of(episode.seed) == "test"
        wild = np.abs(episode.actions[:, 3:5]).max(1) > 0.2  # the expert never tilts
        assert 0.1 < wild.mean() < 0.9
        assert 1 <= np.abs(np.diff((np.abs(episode.actions[:, 3:5]).max(1) > 0).astype(int))).sum() <= 8


def test_curves_are_quartiles_of_the_errors_at_each_step(episodes):
    curves = error_curves(build_model("still", TASK.layout, Control()), episodes, progress=False)
    assert curves.steps.tolist() == [10, 20, 30, 40, 50, 60, 66, 70]
    assert curves.chamfer.shape == (3, 8) and set(curves.positions) == {"hand", "cube"}
    assert (np.diff(curves.chamfer, axis=0) >= 0).all()
    hands = [np.linalg.norm(e.poses[3:, 0, :3] - e.poses[2, 0, :3], axis=1) * 1e3 for e in episodes.episodes]
    np.testing.assert_allclose(curves.positions["hand"], np.percentile(hands, (25, 50, 75), axis=0), atol=1e-2)
    assert set(curves.mean_chamfer) == {66}
    assert curves.summary()["steps"][-1] == 70


def test_quartiles_are_drawn():
    rising = np.stack([np.linspace(0, k, 50) for k in (1, 2, 3)])
    image = np.asarray(draw_quartiles({"hand": rising, "cube": 2 * rising}, "errors"))
    assert image.shape == (360, 980, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20
    flat = np.asarray(draw_quartiles({"hand": 0 * rising, "cube": 0 * rising}, "errors"))
    assert not np.array_equal(image, flat)
