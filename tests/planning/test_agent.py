import numpy as np
import pytest
import torch

from pwm_gym.costs import cost_info, get_cost, get_grasp
from pwm_gym.dynamics import build_model, load_checkpoint, resolve
from pwm_gym.errors import PwmGymError
from pwm_gym.planning import PLANNERS, ActionNoise, Agent, MPPIConfig, NoiseConfig
from pwm_gym.scene import batch_state
from pwm_gym.tasks import TASKS, get_task

TASK = get_task("PickCube")
QUICK = MPPIConfig(samples=16, elites=4, horizon=4)


@pytest.fixture
def agent(env):
    agent = Agent(env.unwrapped.model, "PickCube", QUICK)
    agent.reset(0)
    return agent


def test_a_tasks_own_planner_is_the_default(env):
    assert Agent(env.unwrapped.model, "PickCube").planner.config == PLANNERS["mppi"]
    kitchen = load_checkpoint(resolve("kitchen", "Coffee")).model
    assert Agent(kitchen, "Coffee").planner.config == PLANNERS["mppi-fine"] != PLANNERS["mppi"]
    assert {task.planner for task in TASKS.values()} <= {*PLANNERS}


def test_it_goes_on_in_the_model_from_where_it_looked(agent, env, scene):
    """Planning without looking is planning from the model's own prediction."""
    first = agent.act(scene)
    agent.advance(first)
    env.reset(options={"scene": scene})
    env.step(first)
    unseen = agent.plan()
    agent.reset(0)
    assert np.array_equal(agent.act(scene), first)
    np.testing.assert_allclose(agent.plan(env.unwrapped.scene()), unseen, atol=1e-3)


def test_it_plans_for_several_scenes_at_once(agent, env):
    scenes = [env.unwrapped.vector.checkpoint.bank("PickCube").scene(i) for i in range(3)]
    plans = agent.plan(scenes)
    assert plans.shape == (3, 4, 7)
    assert agent.plan(scenes[:1]).shape == (1, 4, 7) and agent.plan(scenes[0]).shape == (4, 7)
    assert len({p.tobytes() for p in plans}) == 3
    agent.look(scenes)
    assert agent.plan().shape == (3, 4, 7) and agent.act().shape == (3, 7)
    assert agent.advance(agent.act()).batch == (3,)


def test_scenes_of_a_batch_are_planned_for_each_by_itself(env):
    """Costs of the same actions, together and one by one."""
    agent = Agent(env.unwrapped.model, "PickCube", QUICK)
    scenes = [env.unwrapped.vector.checkpoint.bank("PickCube").scene(i) for i in range(3)]
    goals = torch.as_tensor(np.stack([s.goal for s in scenes]))
    actions = torch.rand(3, 2, 4, 7, generator=torch.Generator().manual_seed(0)) - 0.5
    together = agent.objective.begin(batch_state(scenes), goals)(actions)
    for b in range(3):
        alone = agent.objective.begin(batch_state(scenes[b : b + 1]), goals[b : b + 1])(actions[b : b + 1])
        torch.testing.assert_close(together[b], alone[0], atol=1e-3, rtol=1e-4)
    assert together.std(0).min() > 1e-3


def test_a_plan_is_the_callers_own(agent, scene):
    plan = agent.plan(scene)
    plan[:] = 7.0
    assert abs(agent.plan(scene)).max() <= 1.0


def test_the_objectives_gradient_is_that_of_finite_differences(env, scene):
    """Through the arm's inverse kinematics, too."""

    def low(points, info):
        return points["hand"].mean(-2)[..., 2]

    objective = Agent(env.unwrapped.model, "PickCube", QUICK, cost=low).objective
    objective.begin(batch_state([scene]), torch.as_tensor(scene.goal)[None])
    around = torch.zeros(1, 1, 5, 7)
    around[..., :3] = 0.1  # at rest it has a kink
    actions = around.clone().requires_grad_()
    objective(actions).sum().backward()
    for step in range(5):
        for axis in (0, 2):
            nudge = torch.zeros(1, 1, 5, 7)
            nudge[..., step, axis] = 0.005
            change = (objective(around + nudge) - objective(around - nudge)).sum() / 0.01
            assert actions.grad[0, 0, step, axis] == pytest.approx(float(change), rel=0.02, abs=5e-4)
    assert actions.grad[0, 0, 0, 2] > 0.1


def test_it_needs_a_scene_first(agent, scene):
    with pytest.raises(PwmGymError, match="no state yet"):
        agent.plan()
    agent.look(scene)
    agent.plan()
    agent.reset(0)
    with pytest.raises(PwmGymError, match="no state yet"):
        agent.advance(np.zeros(7))


def test_terms_and_rewards_are_those_of_the_costs(agent, scene):
    agent.look(scene)
    states = agent.advance(np.full(7, 0.5, np.float32))[[0, 0, 0]]
    actions = np.linspace(0, 1, 21, dtype=np.float32).reshape(3, 7)
    goals = torch.as_tensor(scene.goal, dtype=torch.float32).expand(3, -1)
    points, info = cost_info(states, torch.as_tensor(actions), goals, get_grasp(TASK.grasp))
    expected = get_cost(TASK.plan_cost).evaluate(points, info)
    terms = agent.terms(states, actions)
    assert terms.keys() == expected.keys() == agent.cost.terms.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(terms[name], value.numpy())
    assert sum(abs(v).sum() for v in terms.values()) > 0
    np.testing.assert_array_equal(agent.rewards(states, actions), -get_cost(TASK.cost)(points, info).numpy())


def test_caution_avoids_what_the_model_is_unsure_of(env, scene):
    """Between two equally good directions it takes the one with the smaller expected error."""
    model = env.unwrapped.model

    class Unsure:
        links, action_size = model.links, model.action_size

        def prepare(self, state):
            return model.prepare(state)

        def step(self, state, action):
            moved = model.step(state, action)
            if state.error is None:
                return moved
            return moved.advance(moved.poses(), moved.joints, state.error + action[:, :1].clamp_min(0.0))

    def flat(points, info):
        return 0.0 * info["action"][..., 0]

    first = {}
    for caution in (0.0, 10.0):
        agent = Agent(Unsure(), "PickCube", MPPIConfig(samples=64, elites=8, horizon=4), cost=flat, caution=caution)
        agent.reset(0)
        first[caution] = agent.plan(scene)[:, 0].mean()
    assert first[10.0] < -0.1 and first[10.0] < first[0.0]


def test_without_caution_expected_errors_are_not_worked_out(env, scene, monkeypatch):
    model = env.unwrapped.model
    calls = []
    forward = model.error.forward
    monkeypatch.setattr(model.error, "forward", lambda tokens: calls.append(1) or forward(tokens))
    Agent(model, "PickCube", QUICK).plan(scene)
    assert not calls
    Agent(model, "PickCube", QUICK, caution=1.0).plan(scene)
    assert len(calls) == QUICK.horizon


def test_caution_needs_a_model_that_tells_its_error(scene):
    still = build_model("still", TASK.layout, TASK.control)
    agent = Agent(still, "PickCube", QUICK, caution=1.0)
    with pytest.raises(PwmGymError, match=r"caution=1.0; .* does not tell its expected error"):
        agent.plan(scene)


def test_penalties_may_not_hide_a_term_of_the_cost(env):
    with pytest.raises(ValueError, match="has a term 'carry' already"):
        Agent(env.unwrapped.model, penalties={"carry": (1.0, lambda points, info: torch.zeros(1))})


def test_plans_start_from_what_a_guide_would_do(env, scene):
    """A planner with next to no noise follows the guide where its cost is the lower one."""
    model = env.unwrapped.model
    config = MPPIConfig(samples=4, elites=1, horizon=3, noise=ActionNoise.uniform(NoiseConfig((1e-6,))), stop_samples=0)
    seen = []

    def guide(state, goal):
        seen.append(state.poses())
        return torch.full((len(goal), 7), 0.25)

    def low(points, info):
        return points["hand"].mean(-2)[..., 0]

    def high(points, info):
        return -low(points, info)

    plans = {}
    for cost in (low, high):
        agent = Agent(model, "PickCube", config, cost=cost, guide=guide)
        agent.reset(0)
        plans[cost] = agent.plan(scene)
    assert len(seen) == 6 and not torch.equal(seen[0], seen[2])  # it acts in the states that it would come to
    np.testing.assert_allclose(plans[high], 0.25, atol=1e-3)
    np.testing.assert_allclose(plans[low][:, :6], 0.0, atol=1e-3)
