from dataclasses import replace

import numpy as np
import pytest
import torch
import tyro

from pwm_gym.errors import PwmGymError
from pwm_gym.planning import (
    ActionNoise,
    CEMConfig,
    GradientConfig,
    MPPIConfig,
    NoiseConfig,
    build_planner,
)
from pwm_gym.planning.noise import counterparts, power_law_noise, together_mask
from pwm_gym.robots import Arm, Channel, Control
from pwm_gym.tasks import get_task


@pytest.mark.parametrize("horizon", [1, 2, 7, 10])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_power_law_noise_is_standard_normal(horizon, exponent):
    noise = power_law_noise((2, 4000, horizon, 2), exponent, torch.Generator().manual_seed(0))
    assert noise.shape == (2, 4000, horizon, 2)
    torch.testing.assert_close(noise.mean((0, 1)), torch.zeros(horizon, 2), atol=0.05, rtol=0)
    torch.testing.assert_close(noise.std((0, 1)), torch.ones(horizon, 2), atol=0.05, rtol=0)


def test_its_colour_is_the_exponent():
    noise = power_law_noise((20_000, 12, 1), 2.0, torch.Generator().manual_seed(0))[..., 0]
    power = torch.fft.rfft(noise, dim=-1).abs().square().mean(0)
    for k in (2, 3, 5):
        assert (power[1] / power[k]).item() == pytest.approx(k**2, rel=0.1)


def test_an_exponent_of_zero_is_white():
    noise = power_law_noise((20_000, 6, 1), 0.0, torch.Generator().manual_seed(0))[..., 0]
    torch.testing.assert_close(torch.corrcoef(noise.T), torch.eye(6), atol=0.04, rtol=0)


# Settings by kind of channel ---------------------------------------------------------------------------------------

PLANNERS = {"mppi": MPPIConfig, "cem": CEMConfig, "icem": CEMConfig.icem, "gradient": GradientConfig}
SCARA = Control((Channel("translation", 0, 3, 0.1, arm="arm"), Channel("gripper", 3, 4, rest=1.0, arm="arm")),
                (Arm("arm", "hand"),))  # fmt: skip
NO_ARM = Control((Channel("joint", 0, 2), Channel("joint", 2, 3, rest=None)))


def two_hands():
    """24 components: each arm has a pose of six and six fingers with absolute targets."""
    channels = []
    for k, arm in enumerate(("left", "right")):
        start = 12 * k
        for kind, first, last, rest in (("translation", 0, 3, 0.0), ("rotation", 3, 6, 0.0), ("finger", 6, 12, None)):
            channels.append(Channel(kind, start + first, start + last, rest=rest, arm=arm))
    return Control(tuple(channels), (Arm("left", "left_hand"), Arm("right", "right_hand")))


BOTH = two_hands()


def seen_by(config, control, last_action=None, plans=1):
    """Samples (S, H, A) of the last of so many plans around the plan before."""
    seen = []
    planner, source = build_planner(config, control), torch.Generator().manual_seed(0)
    for _ in range(plans):
        planner.plan(lambda a: (seen.append(a.detach().clone()), a.square().sum((-1, -2)))[1], source, 1, last_action)
    return seen[-1][0]


def test_the_pandas_settings_are_what_they_were():
    """Tuned on PickCube's planning-validation seeds, when settings were written by component."""
    found = ActionNoise().resolve(get_task("PickCube").control)
    assert found.sigma == (0.3, 0.3, 0.3, 0.0, 0.0, 0.3, 0.7)
    assert found.correlation == (0.7,) * 6 + (0.97,)
    assert found.min_noise_scale == (0.2,) * 6 + (1.0,)  # of rotations about x and y it does not matter
    assert found.bound == (1.0,) * 7


@pytest.mark.parametrize("control", [SCARA, BOTH, NO_ARM], ids=["4", "24", "no arm"])
@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_plans_with_every_robot(planner, control):
    config = replace(PLANNERS[planner](), samples=32, elites=4, horizon=6)
    target = torch.linspace(-0.3, 0.3, control.size)
    free = torch.tensor(config.noise.resolve(control).sigma) > 0

    def objective(actions):
        return (actions - target).square().sum((-1, -2))

    made, source = build_planner(config, control), torch.Generator().manual_seed(0)
    plans = [made.plan(objective, source, batch=2) for _ in range(12)]
    assert plans[0].shape == (2, 6, control.size) and plans[-1].abs().max() <= 1.0
    first, last = ((p - target)[..., free].square().mean() for p in (plans[0], plans[-1]))
    assert last < 0.7 * first


def test_a_first_plan_stands_still_and_keeps_absolute_targets_where_they_are():
    last = torch.linspace(-0.9, 0.9, 24)[None]
    mean = seen_by(MPPIConfig(), BOTH, last)[-1]
    fingers = torch.tensor([kind == "finger" for kind in BOTH.kinds])
    assert torch.equal(mean, torch.where(fingers, last, 0.0).expand(10, -1))
    assert torch.equal(seen_by(MPPIConfig(), BOTH)[-1], torch.zeros(10, 24))  # nothing is known
    shut = torch.tensor([[0.5, 0.5, 0.5, -1.0]])
    assert torch.equal(seen_by(MPPIConfig(), SCARA, shut)[-1], torch.tensor([0.0, 0.0, 0.0, -1.0]).expand(10, -1))


def test_samples_that_stop_hold_fingers_and_absolute_joints():
    last = torch.full((1, 24), 0.25)
    fingers = torch.tensor([kind == "finger" for kind in BOTH.kinds])
    *_, after_two, after_one, at_once, mean = seen_by(MPPIConfig(), BOTH, last, plans=2)
    assert (mean[:, fingers] != 0.25).any()
    assert (at_once[:, fingers] == 0.25).all() and (at_once[:, ~fingers] == 0).all()
    for steps, sample in ((1, after_one), (2, after_two)):
        assert torch.equal(sample[:steps], mean[:steps])
        assert (sample[steps:, ~fingers] == 0).all()
        assert torch.equal(sample[steps:, fingers], mean[steps - 1, fingers].expand(10 - steps, -1))
    *_, stopped, _ = seen_by(MPPIConfig(), NO_ARM, torch.tensor([[0.5, 0.5, 0.5]]))
    assert torch.equal(stopped, torch.tensor([0.0, 0.0, 0.5]).expand(10, -1))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_one_arm_the_other_or_both_are_perturbed(share):
    config = MPPIConfig(samples=240, stop_samples=0, single_arm_share=share)
    samples = seen_by(config, BOTH)[:-1]
    left, right = (samples[..., part].abs().amax((-1, -2)) > 0 for part in (slice(0, 12), slice(12, 24)))
    assert (left | right).all()
    assert (left & right).float().mean() == pytest.approx(1.0 - share, abs=0.02)
    assert (left & ~right).float().mean() == pytest.approx(share / 2, abs=0.02)
    if 0.0 < share < 1.0:  # wide samples and fine ones
        assert (left & right)[:60].float().mean() == pytest.approx(1.0 - share, abs=0.06)


@pytest.mark.parametrize("share", [0.0, 0.45, 1.0])
def test_one_component_alone_or_all_that_have_noise_are_perturbed(share):
    control = get_task("PickCube").control
    config = MPPIConfig(samples=300, stop_samples=0, single_component_share=share)
    *samples, mean = seen_by(config, control, last_action=torch.zeros(1, control.size))
    moves = (torch.stack(samples) - mean).abs().amax(1) > 0  # (S, 7)
    noisy = [0, 1, 2, 5, 6]  # a tool that points down turns about z alone
    alone = moves.sum(-1) == 1
    assert (alone | (moves.sum(-1) == len(noisy))).all() and not moves[:, [3, 4]].any()
    assert alone.float().mean() == pytest.approx(share, abs=0.02)
    for k in noisy:
        assert (alone & moves[:, k]).float().mean() == pytest.approx(share / len(noisy), abs=0.02)
    if 0.0 < share < 1.0:  # wide samples and fine ones
        assert alone[:75].float().mean() == pytest.approx(share, abs=0.06)


def test_scales_shrink_by_factors_and_stop_samples_replace_none_of_the_finest():
    noise = ActionNoise.uniform(NoiseConfig(sigma=(0.5,), correlation=0.0, min_noise_scale=0.01))
    config = MPPIConfig(samples=200, stop_samples=10, geometric_scales=True, noise=noise)
    *samples, mean = seen_by(config, SCARA, torch.zeros(1, 4))
    size = (torch.stack(samples)[:-10] - mean).square().mean((1, 2)).sqrt()
    first, half, last = (float(part.mean()) for part in (size[:10], size[90:100], size[-10:]))
    assert 0.3 < first < 0.5
    assert half == pytest.approx(0.05, rel=0.3) and last == pytest.approx(0.005, rel=0.4)


def test_every_sample_of_several_arms_perturbs_something():
    config = MPPIConfig(
        samples=300,
        stop_samples=0,
        single_arm_share=0.5,
        single_component_share=0.5,
        noise=ActionNoise.uniform(NoiseConfig(sigma=(0.5,), correlation=0.0)),
    )
    *samples, mean = seen_by(config, BOTH, last_action=torch.zeros(1, 24))
    moves = (torch.stack(samples) - mean).abs().amax(1) > 0  # (S, A)
    assert moves.any(1).all()
    components = moves.sum(1)
    assert (components == 1).float().mean() == pytest.approx(0.5, abs=0.03)
    assert {int(n) for n in components.unique()} == {1, 12, 24}  # a component, an arm, both


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_one_channel_alone_is_perturbed(share):
    noise = ActionNoise.uniform(NoiseConfig(sigma=(0.5,), correlation=0.0))
    config = MPPIConfig(samples=600, stop_samples=0, single_arm_share=0.0, single_channel_share=share, noise=noise)
    *samples, mean = seen_by(config, BOTH, last_action=torch.zeros(1, 24))
    moves = (torch.stack(samples) - mean).abs().amax(1) > 0  # (S, A)
    for channel in BOTH.channels:
        alone = moves[:, channel.slice].all(1) & (moves.sum(1) == channel.stop - channel.start)
        assert alone.float().mean() == pytest.approx(share / len(BOTH.channels), abs=0.02)
        assert alone[:300].float().mean() == pytest.approx(
            float(alone[300:].float().mean()), abs=0.03
        )  # wide ones and fine
    assert moves.all(1).float().mean() == pytest.approx(1.0 - share, abs=0.02)


def test_a_component_alone_comes_before_a_channel_and_a_channel_before_an_arm():
    shares = {"single_arm_share": 1.0, "single_channel_share": 0.5, "single_component_share": 0.5}
    noise = ActionNoise.uniform(NoiseConfig(sigma=(0.5,), correlation=0.0))
    *samples, mean = seen_by(MPPIConfig(samples=600, stop_samples=0, noise=noise, **shares), BOTH, torch.zeros(1, 24))
    count = ((torch.stack(samples) - mean).abs().amax(1) > 0).sum(1)
    assert (count == 1).float().mean() == pytest.approx(0.5, abs=0.02)
    assert set(count.tolist()) == {1, 3, 6, 12}


def test_settings_that_do_not_fit_the_control_are_named():
    wide = replace(ActionNoise(), translation=NoiseConfig((0.1, 0.2)))
    with pytest.raises(PwmGymError, match="translation sigma has 2 values; expected 1 or 3"):
        build_planner(MPPIConfig(noise=wide), SCARA)
    with pytest.raises(PwmGymError, match="the control has no channels"):
        build_planner(MPPIConfig(), Control())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sigma": ()}, r"sigma=\(\); expected values of at least 0"),
        ({"sigma": (-0.1,)}, r"sigma=\(-0.1,\); expected values of at least 0"),
        ({"sigma": (float("nan"),)}, r"sigma=\(nan,\); expected"),
        ({"correlation": 1.1}, "correlation=1.1; expected 0 to 1"),
        ({"min_noise_scale": -1.0}, "min_noise_scale=-1.0; expected 0 to 1"),
        ({"bound": 0.0}, "bound=0.0; expected more than 0 and at most 1"),
    ],
)
def test_noise_that_cannot_be_is_refused(changes, message):
    with pytest.raises(PwmGymError, match=message):
        NoiseConfig(**changes)


def test_a_bound_limits_its_kind_of_channel_alone():
    slow = replace(ActionNoise(), translation=NoiseConfig(bound=0.2))
    samples = seen_by(MPPIConfig(noise=slow), SCARA)
    assert samples[..., :3].abs().max() == pytest.approx(0.2) and samples[..., 3].abs().max() == 1.0


def test_the_command_line_reaches_every_setting():
    words = ["--noise.gripper.sigma", "0.9", "--noise.rotation.sigma", "0.1", "0.1", "0.3", "--stop-samples", "0"]
    config = tyro.cli(MPPIConfig, args=words)
    assert config.noise.gripper == NoiseConfig((0.9,), 0.97, 1.0)
    assert config.noise.rotation.sigma == (0.1, 0.1, 0.3) and config.stop_samples == 0
    assert config.noise.translation == MPPIConfig().noise.translation


def test_fingers_of_a_hand_move_together_each_a_little_its_own_way():
    noise = ActionNoise(finger=NoiseConfig(sigma=(0.3,), correlation=0.0, min_noise_scale=1.0, synergy=0.8))
    config = MPPIConfig(samples=4000, horizon=1, stop_samples=0, single_arm_share=0.0, noise=noise)
    *samples, mean = seen_by(config, BOTH, last_action=torch.zeros(1, 24))
    moves = (torch.stack(samples) - mean)[:, 0]
    found = torch.cov(moves.T).numpy() / 0.3**2
    fingers = [k for k, kind in enumerate(BOTH.kinds) if kind == "finger"]
    left, right = fingers[: len(fingers) // 2], fingers[len(fingers) // 2 :]
    pairs = [(i, k) for hand in (left, right) for i in hand for k in hand if i < k]
    assert np.mean([found[pair] for pair in pairs]) == pytest.approx(0.8, abs=0.03)
    assert np.abs(found[np.ix_(left, right)]).max() < 0.1 and abs(found[0, 1]) < 0.1
    assert moves[:, fingers].std() == pytest.approx(0.3, rel=0.05)  # as wide as without a synergy
    with pytest.raises(PwmGymError, match="synergy=1.5; expected 0 to 1"):
        NoiseConfig(synergy=1.5)


def test_in_some_samples_all_arms_go_the_same_way_and_nothing_else_moves():
    noise = ActionNoise.uniform(NoiseConfig(sigma=(0.3,), correlation=0.0, min_noise_scale=1.0))
    config = MPPIConfig(samples=200, stop_samples=0, noise=noise, single_arm_share=0.5, together_share=0.3)
    *samples, mean = seen_by(config, BOTH, last_action=torch.zeros(1, 24))
    moves = torch.stack(samples) - mean
    alike = (moves[..., :12] - moves[..., 12:]).abs().amax((-1, -2)) < 1e-6
    assert alike.float().mean() == pytest.approx(0.3, abs=0.02)
    moved = moves[alike].abs().amax(1)[:, :12] > 0
    assert moved[:, :3].any(1).all() and not moved[:, 3:].any()
    alone = moved[moved.sum(1) == 1][:, :3].sum(0)  # along one axis, each in turn
    assert len(alone.unique()) <= 2 and alone.sum().item() == pytest.approx(0.5 * alike.sum().item(), abs=1)


def test_arms_without_translations_move_alike_in_all_they_have():
    arms = (Arm("a", "hand_a"), Arm("b", "hand_b"))
    by_joints = Control(tuple(Channel("joint", 2 * k, 2 * k + 2, arm=arm.name) for k, arm in enumerate(arms)), arms)
    together = torch.tensor([True, False])
    assert together_mask(by_joints, together).tolist() == [[True] * 4, [False] * 4]


def test_a_robot_of_one_arm_has_no_counterparts():
    assert counterparts(SCARA) == list(range(SCARA.size))
    assert counterparts(BOTH)[12:] == list(range(12))
