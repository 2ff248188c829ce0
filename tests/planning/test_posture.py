from dataclasses import replace

import numpy as np
import pytest
import torch

from pwm_gym.dynamics import load_checkpoint, resolve
from pwm_gym.errors import PwmGymError
from pwm_gym.planning import PLANNERS, Agent, MPPIConfig, PosedModel, Posture, build_planner
from pwm_gym.scene import batch_state
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import HandPosture, get_task

TASK = get_task("TwoArmBoxCleanup")
HANDS = {"left_palm": slice(3, 6), "right_palm": slice(15, 18)}
QUICK = MPPIConfig(samples=8, elites=4, horizon=3, posture=True)


@pytest.fixture(scope="module")
def checkpoint():
    return load_checkpoint(resolve("two-hands", TASK.name))


@pytest.fixture
def start(checkpoint):
    return checkpoint.model.prepare(batch_state([checkpoint.bank(TASK.name).scene(0)]))


class Obedient:
    """Turns hands exactly as they are told, and moves nothing else."""

    links, action_size = TASK.layout, TASK.action_size

    def prepare(self, state):
        return state

    def step(self, state, action):
        poses = state.poses().clone()
        for hand, rotation in HANDS.items():
            k = state.layout.index(hand)
            turn = make_pose(rotation_from_vector(0.1 * action[:, rotation]), torch.zeros(len(action), 3))
            poses[:, k, :3, :3] = turn[:, :3, :3] @ poses[:, k, :3, :3]
        return state.advance(poses)


def tilted(state, vector):
    """The state with both hands turned by a rotation vector."""
    frames = state.frames.clone()
    for hand in HANDS:
        k = state.layout.index(hand)
        frames[:, 0, k, :3, :3] = rotation_from_vector(torch.tensor(vector)) @ frames[:, 0, k, :3, :3]
    return replace(state, frames=frames)


def leans(state):
    """Sine of the angle of each hand's fingers against the vertical."""
    return torch.stack([state.poses()[:, state.layout.index(hand), :2, 2].norm(dim=-1) for hand in HANDS])


@pytest.mark.parametrize("vector", [(0.3, 0.0, 0.0), (0.0, -0.2, 0.0), (0.15, 0.2, 0.5)])
def test_hands_that_lean_are_set_upright_within_a_few_steps(start, vector):
    model, state = PosedModel(Obedient(), Posture(TASK.control)), tilted(start, vector)
    assert leans(state).min() > 0.15
    for _ in range(8):
        state = model.step(state, torch.zeros(1, TASK.action_size))
    assert leans(state).max() < 1e-3


def test_hands_turn_about_the_vertical_as_they_are_told(start):
    model = PosedModel(Obedient(), Posture(TASK.control))
    action = torch.zeros(1, TASK.action_size)
    action[:, 5] = action[:, 17] = 0.5
    state = model.step(start, action)
    k = state.layout.index("left_palm")
    turned = state.poses()[0, k, :3, :3] @ start.poses()[0, k, :3, :3].T
    torch.testing.assert_close(turned[:2, :2].det(), torch.tensor(1.0), atol=2e-3, rtol=0.0)
    assert float(torch.atan2(turned[1, 0], turned[0, 0])) == pytest.approx(0.05, abs=5e-3)


def test_hands_turn_to_their_heading(start):
    """The left palm from -y to x, the right one as it is told, which is not at all."""
    ahead = torch.tensor([[1.0, 0.0, 0.0]])
    model = PosedModel(Obedient(), Posture(TASK.control, {"left": HandPosture(lambda points, info: ahead)}))
    state, action = start, torch.zeros(1, TASK.action_size)
    for _ in range(30):
        state = model.step(state, action)
    left, right = (state.poses()[0, state.layout.index(hand), :3, 0] for hand in HANDS)
    torch.testing.assert_close(left, ahead[0], atol=1e-3, rtol=0.0)
    assert float(right[1]) > 0.99


def test_fingers_take_the_shape_that_they_are_told(start):
    posture = Posture(TASK.control, {"right": HandPosture(fingers=(0.2, None, -1.0, -1.0, -1.0, 0.4))})
    action = torch.rand(1, TASK.action_size)
    kept = posture(start, action)
    assert kept[0, [18, 20, 21, 22, 23]].tolist() == pytest.approx([0.2, -1.0, -1.0, -1.0, 0.4])
    assert torch.equal(kept[:, 6:12], action[:, 6:12]) and kept[0, 19] == action[0, 19]
    assert {*posture.fixed} == {3, 4, 15, 16, 18, 20, 21, 22, 23}


def test_a_plan_leaves_alone_what_the_posture_decides():
    """The planner's own mean never moves there."""
    fixed = Posture(TASK.control, TASK.postures).fixed
    planner = build_planner(PLANNERS[TASK.planner], TASK.control, fixed=fixed)
    plan = planner.plan(lambda actions: actions.sum((-2, -1)), torch.Generator().manual_seed(0))
    planned = [k for k in range(TASK.action_size) if k not in fixed]
    assert planned == [0, 1, 2, 12, 13, 14] and (plan[..., planned] != 0.0).all()
    assert (plan[..., list(fixed)] == 0.0).all()


def test_only_turns_about_horizontal_axes_are_replaced(start):
    upright, action = Posture(TASK.control), torch.rand(1, TASK.action_size) - 0.5
    state = tilted(start, (0.1, 0.0, 0.0))
    kept = upright(state, action)
    free = [k for k in range(TASK.action_size) if k not in (3, 4, 15, 16)]
    assert torch.equal(kept[:, free], action[:, free])
    assert torch.equal(upright(state, kept), kept) and torch.equal(upright(state, -action)[:, 3:5], kept[:, 3:5])


def test_plans_say_what_the_hands_do_by_themselves(checkpoint):
    """The executed action is the one that the plan was judged by."""
    scene = checkpoint.bank(TASK.name).scene(0)
    agent = Agent(checkpoint.model, TASK.name, QUICK)
    agent.reset(0)
    plan = agent.plan(scene)
    agent.reset(0)
    np.testing.assert_array_equal(agent.act(scene), plan[0])
    state = checkpoint.model.prepare(batch_state([scene]))
    for action in plan:
        told = torch.as_tensor(action)[None]
        torch.testing.assert_close(Posture(TASK.control, TASK.postures)(state, told), told)
        state = checkpoint.model.step(state, told)


@pytest.mark.parametrize(
    ("postures", "told"),
    [
        ({"middle": HandPosture()}, "posture of middle: none is known to turn its hand"),
        ({"left": HandPosture(fingers=(0.0, 0.0))}, "posture of left has 2 finger targets; expected 6"),
    ],
)
def test_postures_that_do_not_fit_are_refused(postures, told):
    with pytest.raises(PwmGymError, match=told):
        Posture(TASK.control, postures)


@pytest.mark.parametrize("target", [1.5, float("nan")])
def test_finger_targets_are_those_of_actions(target):
    with pytest.raises(PwmGymError, match=f"finger target {target} of a posture; expected -1 to 1"):
        HandPosture(fingers=(0.0, target))


def test_a_heading_of_another_shape_is_refused(start):
    posture = Posture(TASK.control, {"left": HandPosture(lambda points, info: points["lid"].mean(-2)[..., :2])})
    with pytest.raises(PwmGymError, match=r"heading of left_palm has shape \(1, 2\); expected \(1, 3\)"):
        posture(start, torch.zeros(1, TASK.action_size))


@pytest.mark.parametrize("task", ["FetchPush", "AdroitHandDoor"])
def test_an_arm_whose_rest_is_not_known_cannot_be_kept_upright(task):
    with pytest.raises(PwmGymError, match=r"posture of.*none is known to turn its hand"):
        Posture(get_task(task).control)
