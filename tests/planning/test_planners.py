"""What holds for every planner, and for CEM and the gradient planner alone."""

from dataclasses import dataclass, replace

import pytest
import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.planning import (
    ActionNoise,
    CEMConfig,
    GradientConfig,
    MPPIConfig,
    NoiseConfig,
    SamplingConfig,
    build_planner,
)
from pwm_gym.robots import Channel, Control

TWO = Control((Channel("joint", 0, 1), Channel("gripper", 1, 2, rest=1.0)))


def noise(sigma=0.4, correlation=0.5, least=0.2, gripper=None):
    """The same noise for both channels, but for the gripper's sigma where it is given."""
    every = ActionNoise.uniform(NoiseConfig((sigma,), correlation, least))
    return every if gripper is None else replace(every, gripper=NoiseConfig((gripper,), correlation, least))


PLAIN = {"horizon": 8, "noise": noise(), "stop_samples": 0}
PLANNERS = {
    "mppi": MPPIConfig(samples=128, elites=16, temperature=0.1, **PLAIN),
    "cem": CEMConfig(samples=128, elites=16, **PLAIN),
    "icem": replace(CEMConfig.icem(8), samples=128, elites=16, noise=noise(0.4, 0.0, 1.0), stop_samples=0),
    "gradient": GradientConfig(**PLAIN),
}
TARGETS = torch.tensor([[0.4, -0.3], [-0.2, 0.1], [0.0, 0.3]])


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def point_masses(place, targets):
    """Costs of points (B, 2) that move 0.1 per unit of action: distances from the targets (B, 2) at every step."""

    def objective(actions):
        path = place[:, None, None] + 0.1 * actions.cumsum(-2)
        return ((path - targets[:, None, None]).square().sum(-1) + 1e-8).sqrt().sum(-1)

    return objective


@pytest.fixture(params=PLANNERS)
def config(request):
    return PLANNERS[request.param]


def test_points_reach_their_targets_and_stay(config):
    planner, source, place, places = build_planner(config, TWO), generator(), torch.zeros(3, 2), []
    for _ in range(16):
        place = place + 0.1 * planner.plan(point_masses(place, TARGETS), source, batch=3)[:, 0]
        places.append(place)
    assert (torch.stack(places[10:]) - TARGETS).norm(dim=-1).mean() < 0.02


def test_plans_are_actions_and_the_seed_decides_them(config):
    plans = []
    for seed in (0, 0, 1):
        objective = point_masses(torch.zeros(3, 2), 10 * TARGETS)
        plans.append(build_planner(config, TWO).plan(objective, generator(seed), batch=3))
    assert plans[0].shape == (3, 8, 2)
    assert plans[0].abs().max() <= 1
    assert not plans[0].requires_grad
    assert torch.equal(plans[0], plans[1])
    assert not torch.equal(plans[0], plans[2])


def test_fewer_and_fewer_samples_still_hold_those_that_stop():
    config = CEMConfig(samples=100, elites=4, shrink=1.5, iterations=7, horizon=10, noise=noise())
    planner = build_planner(config, TWO)
    assert planner.plan(point_masses(torch.zeros(3, 2), TARGETS), generator(), batch=3).shape == (3, 10, 2)


def test_a_dimension_without_noise_keeps_its_mean(config):
    planner = build_planner(replace(config, noise=noise(0.5, gripper=0.0)), TWO)
    plan = planner.plan(point_masses(torch.zeros(1, 2), TARGETS[:1]), generator())
    assert (plan[..., 1] == 1.0).all()
    assert (plan[..., 0] != 0.0).any()


def test_forgets_its_last_plan(config):
    planner = build_planner(config, TWO)
    objective = point_masses(torch.zeros(1, 2), TARGETS[:1])
    first = planner.plan(objective, generator())
    assert not torch.equal(planner.plan(objective, generator()), first)
    planner.reset()
    assert torch.equal(planner.plan(objective, generator()), first)


def seen_by(config, plans=1):
    """The samples that an objective was asked about, and the last plan."""
    seen = []
    planner, source = build_planner(config, TWO), generator()
    objective = point_masses(torch.zeros(1, 2), TARGETS[:1])
    for _ in range(plans):
        plan = planner.plan(lambda a: (seen.append(a.detach().clone()), objective(a))[1], source)
    return seen, plan, objective


def test_cem_narrows_down():
    seen, plan, objective = seen_by(replace(PLANNERS["cem"], noise=noise(least=1.0), iterations=12))
    widths = [float(a.std(1).mean()) for a in seen]
    assert widths == sorted(widths, reverse=True) and widths[-1] < 0.5 * widths[0]
    assert objective(plan.unsqueeze(1)).item() < objective(seen[0]).min().item()


def test_cem_never_narrows_below_its_floor():
    config = replace(PLANNERS["cem"], noise=noise(least=1.0), iterations=30, floor=0.5, inertia=0.0, elites=2)
    seen, _, _ = seen_by(config)
    free = seen[-1][0, :-1].abs().lt(1.0).all(0)  # clipping narrows the others
    assert free.any()
    assert seen[-1].std(1)[0][free].min() > 0.8 * 0.5 * 0.4


def test_icem_keeps_elites_between_iterations_and_plans():
    config = PLANNERS["icem"]
    kept = round(config.keep_elite_fraction * config.elites)
    seen, _, objective = seen_by(config, plans=2)
    for k in (1, 2):
        order = objective(seen[k - 1])[0].argsort()[:kept]
        assert torch.equal(seen[k][0, -kept:], seen[k - 1][0, order])
    order = objective(seen[2])[0].argsort()[:kept]
    shifted = seen[2][0, order]
    assert torch.equal(seen[3][0, -kept:], torch.cat([shifted[:, 1:], shifted[:, -1:]], 1))


def test_icem_has_fewer_samples_from_iteration_to_iteration_and_returns_the_best():
    seen, plan, objective = seen_by(PLANNERS["icem"])
    kept = round(PLANNERS["icem"].keep_elite_fraction * PLANNERS["icem"].elites)
    assert [a.shape[1] for a in seen] == [128, 102 + kept, 81 + kept]
    samples = torch.cat(seen, 1)
    assert torch.equal(plan[0], samples[0, objective(samples)[0].argmin()])


def test_the_gradient_planner_descends():
    config = replace(PLANNERS["gradient"], iterations=20)
    seen, plan, objective = seen_by(config)
    sampled, refined = objective(seen[0]).min(), objective(plan.unsqueeze(1)).min()
    assert refined < 0.9 * sampled


def test_the_gradient_planner_never_returns_worse_than_it_sampled():
    config = replace(PLANNERS["gradient"], rate=5.0, iterations=1)  # overshoots
    seen, plan, objective = seen_by(config)
    assert objective(plan.unsqueeze(1)).item() <= objective(seen[0]).min().item() + 1e-6


@pytest.mark.parametrize(
    ("planner", "changes", "message"),
    [
        ("cem", {"inertia": 1.5}, "inertia=1.5; expected 0 to 1"),
        ("cem", {"floor": -0.1}, "floor=-0.1; expected 0 to 1"),
        ("cem", {"keep_elite_fraction": 2.0}, "keep_elite_fraction=2.0; expected 0 to 1"),
        ("cem", {"shrink": 0.5}, "shrink=0.5; expected at least 1"),
        ("gradient", {"rate": 0.0}, "rate=0.0; expected more than 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(planner, changes, message):
    with pytest.raises(PwmGymError, match=message):
        replace(PLANNERS[planner], **changes)


def test_the_gradient_planner_leaves_a_learned_costs_own_gradients_alone():
    network = torch.nn.Linear(2, 1)
    build_planner(PLANNERS["gradient"], TWO).plan(lambda a: network(a).sum((-1, -2)), generator())
    assert network.weight.grad is None


def test_a_foreign_configuration_is_refused():
    @dataclass(frozen=True)
    class Foreign(SamplingConfig):
        pass

    with pytest.raises(PwmGymError, match="Foreign is no planner's configuration; expected one of MPPIConfig, CEMC"):
        build_planner(Foreign(), TWO)


def test_a_proposal_is_taken_where_it_is_cheaper(config):
    """The best sequence is proposed to one environment, a bad one to another, for a planner that hardly seeks."""
    lazy = replace(config, noise=noise(1e-6, 0.0, 1.0))
    planner, steps = build_planner(lazy, TWO), 8
    objective = point_masses(torch.zeros(2, 2), TARGETS[:2])
    good = torch.zeros(steps, 2)
    good[:4] = TARGETS[0] / 0.4
    proposal = torch.stack([good, -TARGETS[1].sign().expand(steps, 2)])
    plan = planner.plan(objective, generator(), batch=2, proposal=proposal)
    without = build_planner(lazy, TWO).plan(objective, generator(), batch=2)
    torch.testing.assert_close(plan[1], without[1], rtol=0.0, atol=1e-3)
    assert objective(plan.unsqueeze(1))[0, 0] < 0.6 * objective(without.unsqueeze(1))[0, 0]


def test_a_proposal_of_another_shape_is_refused(config):
    objective = point_masses(torch.zeros(1, 2), TARGETS[:1])
    with pytest.raises(PwmGymError, match=r"proposal has shape \(1, 3, 2\); expected \(1, 8, 2\)"):
        build_planner(config, TWO).plan(objective, generator(), proposal=torch.zeros(1, 3, 2))
