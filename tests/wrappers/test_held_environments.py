"""Environments of a batch that stand still while others go on, and what a model's uncertainty makes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from batches import LIMIT, late

from pwm_gym.errors import PwmGymError
from pwm_gym.wrappers import vector

HELD = np.array([True, False])


def test_what_is_held_stands_still_and_goes_on_later(make_batch, actions):
    envs = make_batch()
    base = envs.unwrapped
    envs.step(actions[0])
    before = base.scene(0)
    base.hold(HELD)
    for k in range(1, LIMIT + 2):
        _, reward, terminated, truncated, _ = envs.step(actions[k])
        assert reward[0] == 0.0 and not (terminated[0] or truncated[0])
        assert truncated[1] == (k == LIMIT - 1) and (reward[1] != 0.0) == (k != LIMIT)
    after = base.scene(0)
    np.testing.assert_array_equal(after.poses, before.poses)
    np.testing.assert_array_equal(after.last_action, actions[0][0])
    assert base.held.tolist() == HELD.tolist()
    base.hold(~HELD)
    ends = [envs.step(actions[k])[3][0] for k in range(LIMIT)]
    assert ends == [False] * (LIMIT - 2) + [True, False]  # the step before it was held counts alone


def test_what_succeeded_does_not_end_again_while_it_is_held(make_batch, actions, monkeypatch):
    envs = make_batch()
    base = envs.unwrapped
    judged = base.rules.judge
    monkeypatch.setattr(
        type(base.rules), "judge", lambda self, *args: replace(judged(*args), success=torch.ones(2, dtype=torch.bool))
    )
    base.hold(HELD)
    *_, terminated, _, _ = envs.step(actions[0])
    assert terminated.tolist() == [False, True]


def test_what_is_held_keeps_its_stage(make_batch, actions, monkeypatch):
    envs = make_batch(task="MugCleanup")
    base = envs.unwrapped
    judged = base.rules.judge

    def advance(self, state, action, goal, stage):
        found = judged(state, action, goal, stage)
        return replace(found, stage=stage + 1)

    monkeypatch.setattr(type(base.rules), "judge", advance)
    base.hold(HELD)
    info = envs.step(actions[0])[-1]
    assert info["stage"].tolist() == list(base.rules.stage_names[:2])
    info = envs.step(actions[1])[-1]
    assert info["stage"].tolist() == [base.rules.stage_names[0], base.rules.stage_names[2]]


def test_a_reset_lets_go_and_masks_are_checked(make_batch, actions):
    envs = make_batch("Disabled")
    base = envs.unwrapped
    base.hold(HELD)
    envs.reset(seed=1, options={"reset_mask": HELD})
    assert not base.held.any() and envs.step(actions[0])[1][0] != 0.0
    base.end(HELD)
    assert base.done.tolist() == HELD.tolist()
    with pytest.raises(PwmGymError, match="some environments are done"):
        envs.step(actions[1])
    with pytest.raises(PwmGymError, match=r"mask is bool \(3,\); expected a boolean array \(2,\)"):
        base.end(np.zeros(3, bool))
    with pytest.raises(PwmGymError, match="autoreset_mode is 'SameStep'; ending episodes needs 'NextStep'"):
        make_batch("SameStep").unwrapped.end(HELD)


def test_what_is_held_is_not_penalised_and_never_unsure(make_batch, actions):
    envs = vector.UncertaintyPenalty(make_batch(), weight=1.0, limit=1e-6)
    envs.unwrapped.hold(HELD)
    envs.step(actions[0])
    envs.unwrapped.hold(HELD)
    _, reward, _, truncated, info = envs.step(actions[1])
    assert reward[0] == 0.0 and not truncated[0] and info["reason"][0] == ""


def test_a_restart_costs_nothing_though_its_error_is_known(make_batch, actions, monkeypatch):
    envs = vector.UncertaintyPenalty(make_batch(), weight=1.0)
    late(envs)
    for k in range(2):
        truncated = envs.step(actions[k])[3]
    assert truncated[0]
    monkeypatch.setattr("pwm_gym.wrappers.vector.total_error", lambda info: np.ones(2))
    assert envs.step(actions[2])[1][0] == 0.0


def test_what_has_ended_does_not_end_again_while_it_is_held(make_batch, actions):
    envs = make_batch()
    late(envs)
    assert [envs.step(actions[k])[3][0] for k in range(2)] == [False, True]
    envs.unwrapped.hold(HELD)
    assert [envs.step(actions[k])[3][0] for k in (2, 3)] == [False, False]
    assert envs.unwrapped.done[0]  # and restarts when it is let go
    envs.unwrapped.hold(~HELD)
    assert envs.step(actions[4])[1][0] == 0.0 and not envs.unwrapped.done[0]
