from dataclasses import replace

import pytest
import torch

from pwm_gym.dynamics import CompactConfig, CompactModel, WorldModel, rollout
from pwm_gym.dynamics.compact.contact import FALL, ContactFeatures
from pwm_gym.dynamics.compact.model import _FLIGHT, _Block, _gate
from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Control
from pwm_gym.scene import Layout, PointState, RigidState
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import get_task

CONTROL = Control(vectors=((0, 3), (3, 6)))
SMALL = CompactConfig(points=24, point_width=16, width=32, blocks=2)


def equivariant(response):
    """Random response weights that turn with the scene: as of a controller that treats x and y alike."""
    generator = torch.Generator().manual_seed(1)
    weight = torch.zeros_like(response.root_weight)
    for i in range(0, 18, 3):  # two twists and the action's two vectors
        for j in range(0, 6, 3):
            a, b, c = 0.02 * torch.randn(3, generator=generator)
            weight[i : i + 3, j : j + 3] = torch.tensor([[a, b, 0], [-b, a, 0], [0, 0, c]])
    weight[18, [2, 5]] = 0.01 * torch.randn(2, generator=generator)
    response.root_weight.copy_(weight)
    response.slide_weight.normal_(std=0.01, generator=generator)
    response.slide_weight[6:12] = 0.0  # the arm's command
    response.reach.copy_(torch.tensor([0.9, 0.0, 1.0]))


def model_of(layout, config=SMALL, seed=0):
    """A model with random weights in its last layer too, so that all of it moves something."""
    torch.manual_seed(seed)
    model = CompactModel(layout, 7, CONTROL, config).eval()
    torch.nn.init.normal_(model.head.weight, std=0.2)
    torch.nn.init.normal_(model.head.bias, std=0.2)
    equivariant(model.response)
    return model


@pytest.fixture
def state(hand_scenes):
    return hand_scenes(4)


@pytest.fixture
def model(state):
    return model_of(state.layout)


@pytest.fixture
def action():
    return torch.rand(4, 7, generator=torch.Generator().manual_seed(2)) * 2 - 1


def test_is_a_world_model(model, state, action):
    assert isinstance(model, WorldModel)
    states = rollout(model, state, action.unsqueeze(1).expand(-1, 5, -1))
    assert states.points().shape == (4, 5, state.layout.points, 3)
    moved = (states.poses()[:, 0] - state.poses())[..., :3, 3].norm(dim=-1)
    assert (moved > 1e-4).all()  # every entity moves, so that the tests below compare something


@torch.no_grad()
@pytest.mark.parametrize("angle", [0.3, 1.7, 3.1])
def test_turning_the_scene_about_the_vertical_turns_the_prediction(model, state, action, angle):
    turn = make_pose(rotation_from_vector(torch.tensor([0.0, 0.0, angle])), torch.zeros(3))
    turned = RigidState(state.layout, state.clouds, turn @ state.frames)
    vectors = (action[:, :6].view(4, 2, 3) @ turn[:3, :3].T).flatten(1)
    after = model.step(turned, torch.cat([vectors, action[:, 6:]], 1))
    expected = turn @ model.step(state, action).poses()
    torch.testing.assert_close(after.poses(), expected, atol=1e-5, rtol=0)


@torch.no_grad()
def test_another_height_or_tilt_is_another_prediction(model, state, action):
    """Gravity and the table: it is no equivariance to every motion."""
    lift = make_pose(torch.eye(3), torch.tensor([0.0, 0.0, 0.05]))
    lifted = RigidState(state.layout, state.clouds, lift @ state.frames)
    gap = model.step(lifted, action).poses() - lift @ model.step(state, action).poses()
    assert gap.abs().max() > 1e-4


@torch.no_grad()
def test_the_order_of_an_entitys_points_does_not_matter(model, state, action):
    generator = torch.Generator().manual_seed(3)
    order = torch.cat([e.start + torch.randperm(e.points, generator=generator) for e in state.layout])
    shuffled = RigidState(state.layout, state.clouds[:, order], state.frames)
    torch.testing.assert_close(
        model.step(shuffled, action).poses(), model.step(state, action).poses(), atol=1e-6, rtol=0
    )


@torch.no_grad()
def test_a_scene_does_not_depend_on_its_batch(model, state, action):
    together = model.step(state, action).poses()
    for b in range(4):
        alone = model.step(state[b : b + 1], action[b : b + 1]).poses()
        torch.testing.assert_close(alone, together[b : b + 1], atol=1e-6, rtol=0)
    again = model.step(state, action).poses()
    assert torch.equal(again, together)  # and nothing in it is random


@torch.no_grad()
def test_an_untrained_model_follows_the_response_and_leaves_the_object_half_attached(state):
    torch.manual_seed(0)
    model = CompactModel(state.layout, 7, CONTROL, SMALL)
    after = model.step(state, torch.zeros(4, 7))
    torch.testing.assert_close(after.poses()[:, 0], state.poses()[:, 0])  # its response is zero


@torch.no_grad()
def test_a_resting_hand_rests_under_a_zero_action(model, hand_scenes):
    start = hand_scenes(4, moving=False)
    after = model.step(start, torch.zeros(4, 7))
    hand = start.layout.index("hand")
    assert (after.poses() - start.poses())[:, hand].abs().max() < 1e-6
    shut = torch.zeros(4, 7)
    shut[:, 6] = -1.0  # the gripper's command is no command of the arm
    model.response.root_weight[18] = 0.0
    assert (model.step(start, shut).poses() - start.poses())[:, hand].abs().max() < 1e-6


@torch.no_grad()
def test_shut_gates_leave_an_object_exactly_where_it_is(model, state, action):
    model.head.bias[[0, 1, _FLIGHT]] = -20.0
    after = model.step(state, action)
    cube = state.layout.index("cube")
    torch.testing.assert_close(after.poses()[:, cube], state.poses()[:, cube], atol=1e-6, rtol=0)


@torch.no_grad()
def test_an_attached_object_moves_with_the_hand_exactly(model, state, action):
    model.head.bias[[0, 1, _FLIGHT]] = torch.tensor([20.0, -20.0, -20.0])
    hand, cube = state.layout.index("hand"), state.layout.index("cube")

    def held(s):
        return torch.linalg.inv(s.poses()[:, hand]) @ s.poses()[:, cube]

    for _ in range(20):
        after = model.step(state, action)
        torch.testing.assert_close(held(after), held(state), atol=2e-6, rtol=0)
        state = after


@torch.no_grad()
def test_an_object_in_free_flight_falls_and_goes_on_turning(model, state, action):
    model.head.bias[[0, 1, _FLIGHT]] = torch.tensor([-20.0, -20.0, 20.0])
    cube, steps = state.layout.index("cube"), 4
    middle = state.clouds[:, state.layout["cube"].slice].mean(1)

    def centre(poses):
        return (poses[:, cube, :3, :3] @ middle.unsqueeze(-1)).squeeze(-1) + poses[:, cube, :3, 3]

    start, before = (centre(state.frames[:, k]) for k in (0, 1))
    turn = state.frames[:, 0, cube, :3, :3] @ state.frames[:, 1, cube, :3, :3].transpose(1, 2)
    rotation = state.frames[:, 0, cube, :3, :3]
    for _ in range(steps):
        state = model.step(state, action)
        rotation = turn @ rotation
    expected = start + steps * (start - before)
    expected[:, 2] += FALL * steps * (steps + 1) / 2
    torch.testing.assert_close(centre(state.poses()), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(state.poses()[:, cube, :3, :3], rotation, atol=1e-4, rtol=0)


@torch.no_grad()
@pytest.mark.parametrize("creep", [0.0, 1e-7, 1e-5])
def test_an_object_that_rests_does_not_fall(model, hand_scenes, action, creep):
    model.head.bias[[0, 1, _FLIGHT]] = torch.tensor([-20.0, -20.0, 20.0])
    state, start = hand_scenes(moving=False), hand_scenes(moving=False)
    cube = state.layout.index("cube")
    state.frames[:, 1:, cube, 2, 3] += creep
    for _ in range(50):
        state = model.step(state, action)
    torch.testing.assert_close(state.poses()[:, cube], start.poses()[:, cube], atol=2e-6, rtol=0)


@torch.no_grad()
def test_free_flight_does_not_depend_on_how_many_points_a_state_has(state, action):
    model = model_of(state.layout, CompactConfig(points=8, point_width=16, width=32, blocks=1))
    model.head.bias[[0, 1, _FLIGHT]] = torch.tensor([-20.0, -20.0, 20.0])
    cube = state.layout.index("cube")
    full, coarse = (model.step(s, action).poses()[:, cube] for s in (state, state.coarsen(state.layout.truncate(8))))
    torch.testing.assert_close(coarse, full, atol=1e-6, rtol=0)


def test_an_objects_middle_is_of_its_own_points(state):
    counts = {"hand": 24, "left_gripper": 24, "right_gripper": 24, "cube": 40, "ball": 10}
    sliders = {e.name: e.slider for e in state.layout if e.slider is not None}
    layout = Layout.build(list(counts.items()), ["hand", *sliders], sliders)
    clouds = torch.rand(2, layout.points, 3)
    frames = torch.eye(4).expand(2, 3, len(layout), 4, 4)
    middles = model_of(layout, CompactConfig(points=32)).contact.middles(RigidState(layout, clouds, frames))
    expected = [clouds[:, layout["cube"].slice][:, :32].mean(1), clouds[:, layout["ball"].slice].mean(1)]
    torch.testing.assert_close(middles, torch.stack(expected, 1))


@torch.no_grad()
def test_a_batch_of_none_is_moved(model, state, action):
    none = model.step(model.prepare(state)[:0], action[:0])
    assert none.frames.shape == (0, *state.frames.shape[1:])


@torch.no_grad()
def test_the_order_of_the_entities_does_not_matter(model, state, action):
    order = [3, 1, 0, 2]  # places of the new entities in the old layout
    old, count = state.layout, state.layout.entities[0].points
    entities, slices = [], []
    for new, k in enumerate(order):
        e = old.entities[k]
        entities.append(replace(e, start=new * count, stop=(new + 1) * count))
        slices.append(state.clouds[:, e.slice])
    layout = Layout(tuple(entities))
    other = model_of(layout)
    weights = {n: v for n, v in model.state_dict().items() if n != "kind"}
    other.load_state_dict({**weights, "kind": model.kind[order]})
    moved = RigidState(layout, torch.cat(slices, 1), state.frames[:, :, order])
    torch.testing.assert_close(
        other.step(moved, action).poses(), model.step(state, action).poses()[:, order], atol=1e-5, rtol=0
    )


@torch.no_grad()
def test_contact_features_tell_a_point_inside_a_link_from_one_outside(model, state, action):
    contact: ContactFeatures = model.contact
    seen = []
    contact.object.register_forward_pre_hook(lambda _, given: seen.append(given[0]))
    hand, cube = state.layout.index("hand"), state.layout.index("cube")
    for shift in (0.0, 1.0):  # the cube's centre at the middle of the hand's box, and a metre above
        cloud = state.clouds[:, state.layout["hand"].slice][:, : model.config.points]
        middle = 0.5 * (cloud.amin(1) + cloud.amax(1))
        frames = state.frames.clone()
        frames[:, :, cube] = frames[:, :1, hand] @ make_pose(torch.eye(3).expand(4, 3, 3), middle).unsqueeze(1)
        frames[:, :, cube, 2, 3] += shift
        model.step(RigidState(state.layout, state.clouds, frames), action)
    now, soon = 14, 15  # signed distances to the root link's box
    inside, outside = (x.amin(-2)[:, 0] for x in seen)
    assert (inside[:, [now, soon]] < -0.5).all() and (outside[:, [now, soon]] > 0.9).all()


def test_heads_mix_as_pytorchs_attention_does():
    torch.manual_seed(0)
    block, qkv = _Block(32, 4, 2), torch.randn(5, 6, 96)
    q, k, v = qkv.unflatten(-1, (3, 4, 8)).permute(2, 0, 3, 1, 4)
    expected = torch.nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
    torch.testing.assert_close(block._mixed(qkv, None), expected)
    huge = block._mixed(1e4 * qkv, None)
    assert huge.isfinite().all()


def test_a_block_asked_for_some_tokens_gives_the_same():
    torch.manual_seed(0)
    block, tokens = _Block(32, 4, 2), torch.randn(5, 6, 32)
    torch.testing.assert_close(block(tokens, read=4), block(tokens)[:, :4])


def test_no_blocks_is_a_clear_error(state):
    with pytest.raises(PwmGymError, match="blocks=0; expected at least 1"):
        model_of(state.layout, replace(SMALL, blocks=0))


def test_gates_reach_zero_and_one_and_keep_their_gradient():
    logit = torch.tensor([-30.0, -3.0, 0.0, 3.0, 30.0], requires_grad=True)
    value = _gate(logit)
    assert value[[0, 1, 3, 4]].tolist() == [0.0, 0.0, 1.0, 1.0]
    assert value[2].item() == pytest.approx(0.5)
    value.sum().backward()
    assert (logit.grad[1:4] > 0.01).all()


@torch.no_grad()
def test_fingers_stay_on_their_sliders_within_the_limits(model, state, action):
    model.head.weight.normal_(std=2.0, generator=torch.Generator().manual_seed(4))
    effector = model.response.effector
    reached = []
    for _ in range(10):
        state = model.step(state, action)
        openings = effector.openings(state.frames)[:, 0]
        links = effector.links(state.poses()[:, effector.root], openings)
        torch.testing.assert_close(links, state.poses()[:, effector.sliding], atol=1e-6, rtol=0)
        assert openings.min() > -1e-6 and openings.max() < 0.04 + 1e-6
        reached.append(openings)
    assert torch.cat(reached).max() > 0.039  # the limit was felt


@torch.no_grad()
def test_poses_stay_rigid(model, state, action):
    for _ in range(50):
        state = model.step(state, action)
    rotation = state.poses()[..., :3, :3]
    eye = torch.eye(3).expand_as(rotation)
    torch.testing.assert_close(rotation @ rotation.transpose(-1, -2), eye, atol=1e-4, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(4, 4), atol=1e-4, rtol=0)


def test_gradients_reach_every_parameter(model, state, action):
    states = rollout(model, state, action.unsqueeze(1).expand(-1, 2, -1))
    states.points().square().sum().backward()
    trained = {n: p.grad for n, p in model.named_parameters() if not n.startswith("error.")}
    assert [n for n, grad in trained.items() if grad is None or not grad.abs().sum() > 0] == []
    assert all(grad.isfinite().all() for grad in trained.values())
    assert all(p.grad is None for p in model.error.parameters())  # it is fitted when the rest is done


def test_gradients_reach_the_actions(model, state, action):
    action.requires_grad_()
    model.step(state, action).points().sum().backward()
    assert (action.grad.abs().sum(0) > 0).all()


def test_the_default_is_small(state):
    count = sum(p.numel() for p in CompactModel(state.layout, 7, get_task("PickCube").control).parameters())
    assert 0.25e6 < count < 0.265e6  # what docs/models.md says


@torch.no_grad()
def test_a_coarser_scene_works(model, state, action):
    coarse = state.coarsen(state.layout.truncate(5))
    after = model.step(coarse, action)
    assert after.points().shape == (4, 20, 3)
    assert after.layout == coarse.layout


@torch.no_grad()
def test_a_scene_without_objects_works(state, action):
    alone = Layout(state.layout.entities[:3])
    hand = RigidState(alone, state.clouds[:, : alone.points], state.frames[:, :, :3])
    after = model_of(alone).step(hand, action)
    assert after.points().shape == (4, alone.points, 3)
    assert (after.poses() - hand.poses()).abs().amax((-1, -2)).min() > 1e-4


@torch.no_grad()
def test_only_the_first_points_are_read(state, action):
    model = model_of(state.layout, CompactConfig(points=8, point_width=16, width=32, blocks=1))
    coarse = state.coarsen(state.layout.truncate(8))
    hand = state.layout.index("hand")
    full = model.step(state, action).poses()[:, hand]
    torch.testing.assert_close(model.step(coarse, action).poses()[:, hand], full, atol=1e-6, rtol=0)


@torch.no_grad()
def test_points_are_registered_to_poses(model, state, action):
    prepared = model.prepare(PointState.of(state))
    assert isinstance(prepared, RigidState)
    torch.testing.assert_close(
        model.step(prepared, action).poses(), model.step(state, action).poses(), atol=1e-3, rtol=0
    )
    assert torch.equal(model.prepare(state).frames, state.frames)
