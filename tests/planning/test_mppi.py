from dataclasses import replace

import pytest
import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.planning import MPPI, ActionNoise, MPPIConfig, NoiseConfig
from pwm_gym.robots import Channel, Control
from pwm_gym.tasks import get_task


def noise(sigma=0.4, correlation=0.5, least=0.2, gripper=None):
    """The same noise for every channel, but for the gripper's sigma where it is given."""
    every = ActionNoise.uniform(NoiseConfig((sigma,), correlation, least))
    return every if gripper is None else replace(every, gripper=NoiseConfig((gripper,), correlation, least))


def control(joints):
    """So many joints and a gripper."""
    front = (Channel("joint", 0, joints),) if joints else ()
    return Control((*front, Channel("gripper", joints, joints + 1, rest=1.0)))


SMALL = MPPIConfig(samples=128, horizon=8, elites=16, temperature=0.1, noise=noise(), stop_samples=0)
TWO = control(1)
TARGET = torch.tensor([0.4, -0.3])


def point_mass(start=(0.0, 0.0), target=TARGET):
    """Costs of a point that moves 0.1 per unit of action: distance from the target at every step."""

    def objective(actions):
        place = torch.tensor(start) + 0.1 * actions[..., :2].cumsum(-2)
        return (place - target).norm(dim=-1).sum(-1)

    return objective


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def execute(config, steps, start=(0.0, 0.0)):
    """Closed loop; the places that the point comes to."""
    planner, source, place, places = MPPI(config, TWO), generator(), torch.tensor(start), []
    for _ in range(steps):
        action = planner.plan(point_mass(place.tolist()), source)[0, 0]
        place = place + 0.1 * action
        places.append(place)
    return torch.stack(places)


def test_a_point_mass_reaches_its_target_and_stays():
    places = execute(SMALL, 20)
    assert (places[10:] - TARGET).norm(dim=-1).max() < 0.03


def test_the_papers_settings_reach_it_roughly():
    """Sigma 5 saturates most samples: the point comes near, and jitters."""
    places = execute(MPPIConfig.paper(), 30)
    assert (places[10:] - TARGET).norm(dim=-1).mean() < 0.1


def test_the_papers_table():
    paper = MPPIConfig.paper(horizon=20)
    assert (paper.samples, paper.elites, paper.temperature) == (200, 64, 0.7)
    assert (paper.horizon, paper.iterations, paper.stop_samples) == (20, 1, 0)
    assert not paper.relative and paper.single_arm_share == 0.0
    white = paper.noise.resolve(get_task("PickCube").control)
    assert white.sigma == (5.0,) * 7 and white.correlation == (0.0,) * 7 and white.min_noise_scale == (1.0,) * 7
    assert MPPIConfig.paper().horizon == 10


def test_iterations_improve_a_plan():
    objective = point_mass()
    costs = [
        objective(MPPI(replace(SMALL, iterations=n), TWO).plan(objective, generator()).unsqueeze(1)).item()
        for n in (1, 8)
    ]
    best = 0.5 + 0.4 + 0.3  # straight there at 0.1 an axis and step, hence 4 steps
    assert costs[1] < 0.9 * costs[0]
    assert costs[1] < best


def test_the_seed_decides_the_plan():
    plans = [MPPI(SMALL, TWO).plan(point_mass(), generator(seed)) for seed in (0, 0, 1)]
    assert torch.equal(plans[0], plans[1])
    assert not torch.equal(plans[0], plans[2])


def test_the_plan_is_warm_started_from_the_last_one_shifted():
    planner = MPPI(SMALL, TWO)
    plan = planner.plan(point_mass(), generator())
    seen = []
    planner.plan(lambda a: (seen.append(a), point_mass()(a))[1], generator(1))
    mean = seen[0][:, -1]  # the last sample is the mean itself
    torch.testing.assert_close(mean, torch.cat([plan[:, 1:], plan[:, -1:]], 1))
    planner.reset()
    planner.plan(lambda a: (seen.append(a), point_mass()(a))[1], generator(1))
    rest = torch.zeros(1, 8, 2)
    rest[..., -1] = 1.0  # an open gripper
    torch.testing.assert_close(seen[1][:, -1], rest)


@pytest.mark.parametrize("config", [SMALL, MPPIConfig.paper(), replace(SMALL, noise=noise(50.0, gripper=0.0))])
def test_samples_and_plans_are_actions(config):
    seen = []
    plan = MPPI(config, TWO).plan(lambda a: (seen.append(a), point_mass()(a))[1], generator())
    assert seen[0].shape == (1, config.samples, config.horizon, 2)
    assert plan.shape == (1, config.horizon, 2)
    assert seen[0].abs().max() <= 1 and plan.abs().max() <= 1


def test_a_dimension_without_noise_keeps_its_mean():
    seen = []
    config = replace(SMALL, noise=noise(0.5, gripper=0.0))
    MPPI(config, TWO).plan(lambda a: (seen.append(a), point_mass()(a))[1], generator())
    assert (seen[0][..., 1] == 1.0).all() and seen[0][..., 0].std() > 0.1


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_arms_are_planned_in_turn_after_all_of_them_together(share):
    """Each iteration moves one arm alone; where arms also go together, one for all comes first."""
    two = get_task("TwoArmBoxCleanup").control
    half, fixed = two.size // 2, (0, 12)
    config = replace(MPPIConfig.hands(), iterations=3, together_share=share, stop_samples=0)
    seen = []
    MPPI(config, two, fixed=fixed).plan(lambda a: (seen.append(a), a.square().sum((-1, -2)))[1], generator())
    moved = [(actions - actions[:, -1:]).abs().amax((0, 1, 2)) > 0 for actions in seen]
    arms = [(bool(m[:half].any()), bool(m[half:].any())) for m in moved]
    left, right, both = (True, False), (False, True), (True, True)
    assert arms == ([both, left, right] if share else [left, right, left])
    assert not any(m[list(fixed)].any() for m in moved)
    assert all(m[1:3].all() for m, arm in zip(moved, arms, strict=True) if arm[0])


def test_planning_arms_in_turn_keeps_the_one_that_costs_less():
    """What one arm does costs 30 times as much as what the other one does, which is not lost with it."""
    two = get_task("TwoArmBoxCleanup").control
    half = two.size // 2

    def error(actions, part):
        return (actions[..., part] - 0.2).abs().sum((-1, -2))

    def found(**settings):
        noise = ActionNoise.uniform(NoiseConfig((0.3,)))
        planner, source = MPPI(replace(MPPIConfig.hands(), noise=noise, **settings), two), generator()
        for _ in range(20):
            plan = planner.plan(lambda a: 30.0 * error(a, slice(0, half)) + error(a, slice(half, None)), source)
        return float(error(plan, slice(half, None)))

    assert found() < 0.6 * found(in_turn=False, iterations=1, single_arm_share=0.5)


def test_noise_has_the_correlation_and_the_scales_it_is_given():
    seen = []
    config = MPPIConfig(samples=4000, horizon=6, elites=16, noise=noise(0.1, 0.8, 0.1))
    MPPI(config, control(0)).plan(lambda a: (seen.append(a), a.sum((-1, -2)))[1], generator())
    drawn = seen[0][0, :, :, 0] - 1.0  # around the open gripper; clipped above
    inside = seen[0][0, :-1, :, 0] < 1.0
    assert 0.4 < inside.float().mean() < 0.6
    wide, fine = drawn[:1000].abs().mean(), drawn[-1000:].abs().mean()
    assert fine < 0.4 * wide


def test_correlation_of_steps():
    seen = []
    config = MPPIConfig(samples=4000, horizon=3, elites=16, noise=noise(0.1, 0.8, 1.0))
    MPPI(config, TWO).plan(lambda a: (seen.append(a), a.sum((-1, -2)))[1], generator())
    steps = seen[0][0, :-1, :, 0]
    assert steps.std(0) == pytest.approx([0.1] * 3, rel=0.05)
    assert torch.corrcoef(steps.T)[0, 1].item() == pytest.approx(0.8, abs=0.03)
    assert torch.corrcoef(steps.T)[0, 2].item() == pytest.approx(0.64, abs=0.04)


def test_some_samples_stop_after_each_number_of_steps():
    seen = []
    planner = MPPI(
        replace(SMALL, noise=noise(least=0.5, gripper=0.7), stop_samples=3, samples=16, elites=4), control(2)
    )
    planner.plan(point_mass(), generator())
    planner.plan(lambda a: (seen.append(a), point_mass()(a))[1], generator(1))
    *_, third, second, first, mean = seen[0][0]
    assert (mean[:, :2] != 0).any(1).all()
    assert (first[:, :2] == 0).all() and (first[:, 2] == mean[0, 2]).all()
    for steps, sample in ((1, second), (2, third)):
        assert torch.equal(sample[:steps], mean[:steps])
        assert (sample[steps:, :2] == 0).all() and (sample[steps:, 2] == mean[steps - 1, 2]).all()
    assert (seen[0][0, :-4, :, :2] != 0).any(-1).all()


@pytest.mark.parametrize(("stop_samples", "moving"), [(8, 0), (0, 8)])
def test_stop_samples_find_rest_where_every_motion_costs_the_same(stop_samples, moving):
    planner = MPPI(replace(SMALL, stop_samples=stop_samples, temperature=1e-3), TWO)
    planner.plan(point_mass(), generator())
    plan = planner.plan(lambda a: (a[..., :1] != 0).float().sum((-1, -2)), generator(1))
    assert (plan[0, :, 0] != 0).sum() == moving


def test_one_elite_is_the_cheapest_sample():
    seen = []

    def objective(actions):
        seen.append(actions)
        return point_mass()(actions)

    plan = MPPI(replace(SMALL, elites=1), TWO).plan(objective, generator())
    best = point_mass()(seen[0])[0].argmin()
    torch.testing.assert_close(plan[0], seen[0][0, best])


@pytest.mark.parametrize("relative", [True, False])
def test_a_low_temperature_takes_the_best_elite_and_a_high_one_their_mean(relative):
    seen = []

    def objective(actions):
        seen.append(actions)
        return point_mass()(actions)

    plans = [
        MPPI(replace(SMALL, temperature=t, relative=relative), TWO).plan(objective, generator()) for t in (1e-4, 1e4)
    ]
    order = point_mass()(seen[0])[0].argsort()[:16]
    torch.testing.assert_close(plans[0][0], seen[0][0, order[0]], atol=1e-3, rtol=0)
    torch.testing.assert_close(plans[1][0], seen[0][0, order].mean(0), atol=1e-3, rtol=0)


def test_a_batch_of_environments_is_planned_at_once():
    starts, targets = (
        torch.tensor([[0.0, 0.0], [0.2, 0.2], [-0.1, 0.0]]),
        torch.tensor([[0.4, -0.3], [0, 0], [0.3, 0.3]]),
    )

    def objective(actions):  # (B, S, H, TWO)
        place = starts[:, None, None] + 0.1 * actions.cumsum(-2)
        return (place - targets[:, None, None]).norm(dim=-1).sum(-1)

    config = replace(SMALL, iterations=8)
    together = objective(MPPI(config, TWO).plan(objective, generator(), batch=3).unsqueeze(1))[:, 0]
    for b in range(3):
        single = point_mass(starts[b].tolist(), targets[b])
        alone = single(MPPI(config, TWO).plan(single, generator(b)).unsqueeze(1)).item()
        assert together[b].item() == pytest.approx(alone, rel=0.2)


def test_another_batch_size_forgets_the_last_plan():
    planner = MPPI(SMALL, TWO)
    planner.plan(point_mass(), generator(), batch=1)
    assert planner.plan(point_mass(), generator(), batch=2).shape == (2, 8, 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"horizon": 0}, "horizon=0; expected at least 1"),
        ({"iterations": 0}, "iterations=0; expected at least 1"),
        ({"temperature": 0.0}, "temperature=0.0; expected more than 0"),
        ({"elites": 129}, "elites=129; expected 1 to samples=128"),
        ({"stop_samples": -1}, "stop_samples=-1; expected 0 or more"),
        ({"single_arm_share": 1.5}, "single_arm_share=1.5; expected 0 to 1"),
        ({"single_channel_share": -0.5}, "single_channel_share=-0.5; expected 0 to 1"),
        ({"elites": 0}, "elites=0; expected 1 to samples=128"),
    ],
)
def test_settings_that_cannot_be_are_refused(changes, message):
    with pytest.raises(PwmGymError, match=message):
        replace(SMALL, **changes)
