from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.evaluation.calibration import calibration
from pwm_gym.evaluation.rollouts import Rollouts
from pwm_gym.scene import RigidState
from pwm_gym.viewer import draw_calibration


@pytest.fixture
def rollouts(train_split):
    """Two rollouts of 6 and 4 steps; everything is too high by a random distance, which is known."""
    generator = torch.Generator().manual_seed(0)
    truth = torch.eye(4).expand(2, 6, 4, 4, 4).clone()
    off = 0.01 * torch.rand(2, 6, 4, generator=generator)
    predicted = truth.clone()
    predicted[..., 2, 3] += off
    clouds = torch.as_tensor(train_split.clouds).expand(2, 6, -1, -1)
    frames = predicted.unsqueeze(2).expand(-1, -1, 3, -1, -1, -1)
    states = RigidState(train_split.layout, clouds, frames, error=2.0 * off)
    actions, joints = torch.zeros(2, 6, 7), torch.zeros(2, 6, 2, 9)
    return Rollouts(train_split, train_split.episodes[:2], predicted, truth, joints, actions, states, np.array([6, 4]))


def test_a_model_that_knows_its_errors_ranks_them_all(rollouts):
    told = calibration(rollouts, np.array([True, True]))
    assert told["steps"] == 10
    assert told["rank_correlation"] == pytest.approx(dict.fromkeys([*rollouts.dataset.layout.names, "mean"], 1.0))
    assert [b["expected"] for b in told["bins"]] == pytest.approx([2 * b["real_mean"] for b in told["bins"]], rel=1e-4)
    assert np.diff([b["expected"] for b in told["bins"]]).min() > 0


def test_only_the_chosen_episodes_count(rollouts):
    assert calibration(rollouts, np.array([False, True]))["steps"] == 4


def test_a_model_that_is_sure_where_it_errs_ranks_the_other_way(rollouts):
    wrong = replace(rollouts.states, error=0.1 - rollouts.states.error)
    told = calibration(replace(rollouts, states=wrong), np.array([True, True]))
    assert told["rank_correlation"]["cube"] == pytest.approx(-1.0)


def test_a_model_that_does_not_tell_has_no_calibration(rollouts):
    silent = replace(rollouts, states=replace(rollouts.states, error=None))
    assert calibration(silent, np.array([True, True])) is None


def test_the_picture_shows_expected_and_real_errors(rollouts):
    bins = calibration(rollouts, np.array([True, True]))["bins"]
    image = np.asarray(draw_calibration(bins, "calibration"))
    assert image.ndim == 3
    other = np.asarray(draw_calibration([{**b, "real_mean": 0.0} for b in bins], "calibration"))
    assert (image != other).any()
