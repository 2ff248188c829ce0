import pytest
import torch

from pwm_gym.dynamics import WorldModel, build_model, rollout
from pwm_gym.robots.panda import PANDA
from pwm_gym.scene import PointState, RigidState

SETTINGS = {
    "paper-small": {
        "encoder_channels": (8, 16, 32),
        "decoder_channels": (16, 16),
        "bottleneck_heads": 2,
        "points": 16,
        "grid_size": 0.02,
    },
    "particleformer": {"width": 32, "heads": 2},
    "gbnd": {"width": 32, "neighbours": 4},
}
FREE = [{"rigid": False}, {"rigid": False, "entity_features": True}]


def model_of(name, layout, **settings):
    torch.manual_seed(0)
    model = build_model(name, layout, PANDA.control, {**SETTINGS[name], **settings}).eval()
    torch.nn.init.normal_(model.head[-1].weight, std=0.3)
    return model


@pytest.fixture
def state(hand_scenes):
    return hand_scenes(3)


@pytest.fixture
def action():
    return torch.rand(3, 7, generator=torch.Generator().manual_seed(2)) * 2 - 1


@torch.no_grad()
@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("rigid", [False, True])
def test_are_world_models(name, rigid, state, action):
    model = model_of(name, state.layout, rigid=rigid)
    assert isinstance(model, WorldModel)
    states = rollout(model, state, action.unsqueeze(1).expand(-1, 3, -1))
    assert isinstance(states, RigidState if rigid else PointState)
    assert states.points().shape == (3, 3, state.layout.points, 3)
    moved = (states.points()[:, 0] - state.points()).norm(dim=-1)
    assert moved.mean() > 1e-4
    other = rollout(model, state, -action.unsqueeze(1)).points()[:, 0]
    assert (other - states.points()[:, 0]).abs().max() > 5e-6  # the action counts


@torch.no_grad()
@pytest.mark.parametrize("name", SETTINGS)
def test_rigid_entities_keep_their_shapes(name, state, action):
    model = model_of(name, state.layout, rigid=True)
    after = model.step(model.prepare(state), action)
    for entity in state.layout.names:
        before, now = (torch.cdist(s.entity(entity), s.entity(entity)) for s in (state, after))
        torch.testing.assert_close(now, before, atol=1e-4, rtol=0)


@torch.no_grad()
@pytest.mark.parametrize("name", ["particleformer", "gbnd"])
def test_the_order_of_an_entitys_points_does_not_matter(name, state, action):
    model = model_of(name, state.layout)
    generator = torch.Generator().manual_seed(3)
    order = torch.cat([e.start + torch.randperm(e.points, generator=generator) for e in state.layout])
    moved = model.step(model.prepare(state), action).points()
    shuffled = model.step(model.prepare(RigidState(state.layout, state.clouds[:, order], state.frames)), action)
    torch.testing.assert_close(shuffled.points(), moved[:, order], atol=1e-5, rtol=0)


@torch.no_grad()
def test_entity_features_tell_entities_apart(state, action):
    told, untold = (model_of("particleformer", state.layout, entity_features=x) for x in (True, False))
    assert told.channels > untold.channels
    still = RigidState(state.layout, torch.zeros_like(state.clouds), torch.eye(4).expand_as(state.frames))
    moved = [m.step(m.prepare(still), action).points() for m in (told, untold)]  # all points are at one place
    assert moved[0].std(1).max() > 1e-6
    assert moved[1].std(1).max() < 1e-6


@torch.no_grad()
def test_any_count_of_points_can_be_read(state, action):
    model = model_of("gbnd", state.layout)
    coarse = state.coarsen(state.layout.truncate(6))
    assert model.step(model.prepare(coarse), action).points().shape == (3, 24, 3)
