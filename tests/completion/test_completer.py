import timeit

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from pwm_gym.completion import (
    Completer,
    CompletionConfig,
    CompletionNet,
    CompletionTrainConfig,
    HullCompleter,
    LearnedCompleter,
    ViewConfig,
    ViewerFrame,
    Views,
    build_completer,
    chamfer_loss,
    load_completion,
    random_shapes,
    save_completion,
    train_completion,
)
from pwm_gym.errors import CheckpointError, PwmGymError, UnknownNameError
from pwm_gym.evaluation.completion import evaluate_completion, score_completion
from pwm_gym.scene import spread

SMALL = CompletionConfig((64, 32, 16, 8), (8, 8, 16, 16), 4, 32, 1, 2, 32, 2, 32, 16, (2, 2), 16, 4)
TRAINING = CompletionTrainConfig(
    phases=((1, 60, 8), (2, 20, 8)),
    target=128,
    threads=1,
    learning_rate=0.03,  # of 200 steps that it takes to warm up there are 80
    ema_decay=0.9,
    validate_every=40,
    save_every=20,
)
BALL = [trimesh.creation.icosphere(3, 0.5)]


def network():
    torch.manual_seed(0)
    return CompletionNet(SMALL)


def train(folder, training=TRAINING, stop=None, net=None):
    net, saved = net or network(), []

    def save(model, metrics):
        saved.append(metrics)
        save_completion(folder / "checkpoint", model, {}, metrics)
        if stop is not None and len(saved) == stop:
            raise KeyboardInterrupt

    views = Views(BALL, ViewConfig())
    train_completion(net, views, training, folder, lambda model: {"value": 1.0}, save, progress=False)
    return net


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return train(tmp_path_factory.mktemp("completion"))


def test_the_loss_is_the_chamfer_distance():
    a = torch.randn(3, 50, 3, generator=torch.Generator().manual_seed(0), requires_grad=True)
    b = torch.randn(3, 70, 3, generator=torch.Generator().manual_seed(1))
    loss = chamfer_loss(a, b)
    for k in range(3):
        there, back = (cKDTree(y).query(x)[0].mean() for x, y in ((a[k].detach(), b[k]), (b[k], a[k].detach())))
        assert loss[k].item() == pytest.approx(0.5 * (there + back), rel=1e-4)
    loss.sum().backward()
    assert torch.isfinite(a.grad).all() and a.grad.abs().sum() > 0


def test_training_completes_better_than_it_began(trained):
    views = Views(BALL, ViewConfig().clean())
    before, after = (
        evaluate_completion(LearnedCompleter(net), views, ["ball"], each=8, points=256, progress=False)
        for net in (network(), trained)
    )
    assert after["chamfer"] < 0.8 * before["chamfer"]
    assert after["chamfer"] < 0.95 * after["partial"]
    assert after["floor"] == before["floor"] > 0


def test_a_killed_training_resumes_to_the_same_weights(trained, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, stop=1)
    again = train(tmp_path)
    for name, value in trained.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value)


def test_a_saved_network_loads_as_it_was(trained, tmp_path):
    save_completion(tmp_path / "net", trained, {"shapes": 2}, {"chamfer": 30.0})
    net, description = load_completion(tmp_path / "net")
    assert description["training"] == {"shapes": 2} and net.config == SMALL and not net.training
    for name, value in trained.state_dict().items():
        assert torch.equal(net.state_dict()[name], value)
    (tmp_path / "net" / "config.json").write_text("{}")
    with pytest.raises(CheckpointError, match=r"format None; expected 'pwm_gym.completion'"):
        load_completion(tmp_path / "net")
    with pytest.raises(UnknownNameError, match="unknown checkpoint of completion"):
        load_completion(tmp_path / "nothing")


@pytest.mark.parametrize("make", [HullCompleter, lambda: LearnedCompleter(network())])
def test_completers_move_and_scale_with_what_they_see(make):
    completer = make()
    assert isinstance(completer, Completer)
    view = Views(BALL, ViewConfig().clean()).view(0, np.random.default_rng(0))
    done = completer(view.partial, np.zeros(3), 300)
    assert done.points.shape == (300, 3) and done.points.dtype == np.float32
    shift = np.array([0.4, -0.2, 0.1])
    moved = completer(0.1 * view.partial + shift, shift, 300)
    expected = 0.1 * done.points + shift
    assert score_completion(moved.points, expected).chamfer < 6e-3  # a hull's points are drawn anew
    np.testing.assert_allclose(moved.error, 0.1 * done.error, rtol=1e-2)


def test_a_completion_is_what_is_made_of_each_turn_without_strays():
    """The view turned about the line of sight is completed as the view itself, turned."""
    completer = LearnedCompleter(network(), turns=4)
    cloud = np.random.default_rng(0).normal((0.1, 0.2, 1.0), 0.1, (SMALL.points[0], 3))
    seen = spread(cloud, len(cloud))
    count = 4 * SMALL.levels[-1]  # every point of every turn
    whole = completer(seen, np.zeros(3), count)
    assert whole.points.shape == (count, 3)
    frame = ViewerFrame.of(seen, np.zeros(3))
    quarter = frame.turn(0.5 * np.pi).rotation @ frame.rotation.T  # in the camera's frame
    turned = ((seen - frame.centre) @ quarter.T + frame.centre).astype(np.float32)
    expected = (whole.points - frame.centre) @ quarter.T + frame.centre
    assert cKDTree(completer(turned, np.zeros(3), count).points).query(expected)[0].max() < 1e-4
    one = LearnedCompleter(completer.net, turns=1)(seen, np.zeros(3), SMALL.levels[-1])
    assert np.mean(cKDTree(whole.points).query(one.points)[0] < 1e-5) > 0.9  # but for strays
    with pytest.raises(PwmGymError, match="turns=0; expected at least 1"):
        LearnedCompleter(completer.net, turns=0)


def test_a_hull_encloses_what_is_seen():
    ball = trimesh.creation.icosphere(3, 0.05).vertices
    done = HullCompleter()(ball, np.array([1.0, 0.0, 0.0]), 500)
    assert np.abs(np.linalg.norm(done.points, axis=1) - 0.05).max() < 2e-3 and np.isnan(done.error)


@pytest.mark.parametrize(
    ("partial", "eye", "message"),
    [
        (np.zeros((40, 2)), np.zeros(3), r"shape \(40, 2\); expected \(m, 3\)"),
        (np.ones((31, 3)), np.zeros(3), "has 31 points; expected at least 32"),
        (np.full((40, 3), np.nan), np.zeros(3), "holds 120 values that are not finite"),
        (np.random.default_rng(0).normal(size=(40, 3)), np.zeros(2), r"eye has shape \(2,\)"),
    ],
)
def test_bad_clouds_are_named(partial, eye, message):
    for completer in (HullCompleter(), LearnedCompleter(network())):
        with pytest.raises(PwmGymError, match=message):
            completer(partial, eye)


def test_scores_of_known_clouds():
    truth = np.stack(np.meshgrid(*[np.linspace(0, 1, 11)] * 2, [0.0]), -1).reshape(-1, 3)
    shifted = score_completion(truth + [0, 0, 0.01], truth)
    assert shifted.chamfer == shifted.accuracy == shifted.completeness == pytest.approx(0.01)
    assert shifted.centroid == pytest.approx(0.01) and shifted.f_score == pytest.approx(1.0)
    half = score_completion(truth[truth[:, 0] <= 0.5], truth)
    assert half.accuracy == 0 and half.completeness > 0.1 and half.centroid == pytest.approx(0.25)
    assert score_completion(truth + [0, 0, 0.03], truth).f_score == 0


class TestShipped:
    """The network that comes with the package."""

    @pytest.fixture(scope="class")
    @staticmethod
    def completer():
        return build_completer("default")

    def test_it_completes_what_it_never_saw(self, completer):
        _, description = load_completion()
        assert description["training"]["objects"]["held_out"]
        views = Views(random_shapes(12, first=0), ViewConfig().clean())  # training's begin far behind
        found = evaluate_completion(completer, views, list(map(str, range(12))), each=2, progress=False)
        assert found["chamfer"] < 0.6 * min(found["partial"], found["hull"])
        assert found["better_than_hull"] > 0.8
        assert found["error_rank"] > 0.3

    def test_it_knows_where_a_cubes_middle_is(self, completer):
        """On which a grasp depends."""
        views = Views([trimesh.creation.box((1.0, 1.0, 1.0))], ViewConfig().clean())
        found, hull = (
            evaluate_completion(c, views, ["cube"], each=12, progress=False) for c in (completer, HullCompleter())
        )
        assert found["chamfer"] < 0.6 * found["hull"]
        assert found["centroid_percent"] < 0.5 * hull["centroid_percent"]

    @pytest.mark.slow  # of time: beside other processes it takes longer
    def test_it_takes_a_tenth_of_a_second(self, completer):
        view = Views(BALL, ViewConfig().clean()).view(0, np.random.default_rng(0))
        assert min(timeit.repeat(lambda: completer(view.partial, np.zeros(3)), number=1, repeat=7)) < 0.1
