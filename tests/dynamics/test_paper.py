import json
from dataclasses import asdict, replace

import pytest
import torch

from pwm_gym.dynamics.model import WorldModel, rollout
from pwm_gym.dynamics.paper.model import PaperConfig, PaperModel
from pwm_gym.robots import Channel, Control
from pwm_gym.robots.panda import PANDA
from pwm_gym.scene import Layout, PointState

SMALL = PaperConfig(
    encoder_depths=(1, 1, 1),
    encoder_channels=(8, 16, 32),
    encoder_heads=(2, 2, 4),
    encoder_patches=(64, 16, 64),
    decoder_depths=(1, 1),
    decoder_channels=(16, 16),
    decoder_heads=(2, 2),
    decoder_patches=(64, 16),
    bottleneck_heads=4,
    mlp_ratio=2,
    grid_size=0.01,
)
FOUR = Control((Channel("translation", 0, 3), Channel("gripper", 3, 4)))
LAYOUT = Layout.build([("hand", 48), ("finger", 32), ("cube", 48)], driven=("hand", "finger"))


@pytest.fixture
def rng():
    return torch.Generator().manual_seed(0)


@pytest.fixture
def model():
    torch.manual_seed(0)
    model = PaperModel(LAYOUT, FOUR, config=SMALL).eval()
    with torch.no_grad():  # large enough outputs for the comparisons to mean something
        model.head[-1].weight.normal_(std=0.3)
    return model


def inputs(rng, scenes=2):
    points = torch.rand(scenes, 128, 3, generator=rng) * 0.15
    velocity, previous = 0.01 * torch.randn(2, scenes, 128, 3, generator=rng)
    return points, velocity, previous, torch.rand(scenes, 4, generator=rng) * 2 - 1


def box_surface(size, centre, count, rng):
    """Points (count, 3) spread evenly over the faces of a box: farthest points of more."""
    a, b, c = size
    areas = torch.tensor([b * c, b * c, a * c, a * c, a * b, a * b])
    face = torch.multinomial(areas, 6 * count, replacement=True, generator=rng)
    points = torch.rand(6 * count, 3, generator=rng) - 0.5
    points[torch.arange(6 * count), face // 2] = (face % 2).float() - 0.5
    points = points * torch.tensor(size)
    chosen, distance = [0], torch.full((6 * count,), float("inf"))
    for _ in range(count - 1):
        distance = torch.minimum(distance, (points - points[chosen[-1]]).square().sum(-1))
        chosen.append(int(distance.argmax()))
    return points[chosen] + torch.tensor(centre)


@pytest.fixture
def pick_cube():
    """Boxes as large as the Panda's hand and fingers, and a 4 cm cube: 300 points each, 0.1 x 0.2 x 0.3 m."""
    rng = torch.Generator().manual_seed(0)
    boxes = [
        ((0.06, 0.2, 0.07), (0.0, 0.0, 0.25)),
        ((0.02, 0.02, 0.05), (0.0, 0.04, 0.18)),
        ((0.02, 0.02, 0.05), (0.0, -0.04, 0.18)),
        ((0.04, 0.04, 0.04), (0.05, 0.02, 0.02)),
    ]
    names = ("hand", "left_gripper", "right_gripper", "cube")
    layout = Layout.build([(n, 300) for n in names], driven=names[:3])
    return layout, torch.cat([box_surface(*box, 300, rng) for box in boxes]).unsqueeze(0)


@torch.no_grad()
def test_paper_configuration_has_its_size_and_bottleneck(pick_cube):
    layout, points = pick_cube
    model = PaperModel(layout, PANDA.control, PaperConfig()).eval()
    count = sum(p.numel() for p in model.parameters())
    print(f"parameters: {count}")
    assert 13e6 < count < 14.5e6

    seen = []
    model.conditioning.register_forward_hook(lambda module, args, out: seen.append((args[1].sizes, out.shape[1])))
    still = torch.zeros_like(points)
    moved = model(points, still, still, torch.zeros(1, 7), layout)
    (sizes, width), *_ = seen
    print(f"bottleneck: {sizes} x {width}")
    assert 200 <= sizes[0] <= 400 and width == 256
    assert moved.shape == (1, 1200, 3)
    assert moved.abs().max() < 1e-3  # an untrained model barely moves


@torch.no_grad()
def test_is_a_world_model(model, rng):
    assert isinstance(model, WorldModel)
    points, velocity, previous, action = inputs(rng)
    frames = torch.stack([points, points - velocity, points - velocity - previous], 1)
    state = PointState(LAYOUT, points, frames)
    after = model.step(state, action)
    expected = model(points, velocity, previous, action, LAYOUT)
    torch.testing.assert_close(after.points(), points + expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(after.previous_velocity(), velocity, atol=1e-6, rtol=0)
    assert rollout(model, state, torch.zeros(2, 3, 4)).points().shape == (2, 3, 128, 3)


@torch.no_grad()
def test_is_deterministic_and_leaves_the_global_generator_alone(model, rng):
    data = inputs(rng)
    before = torch.get_rng_state()
    a, b = model(*data, LAYOUT), model(*data, LAYOUT)
    assert torch.equal(a, b)
    assert torch.equal(before, torch.get_rng_state())


@torch.no_grad()
def test_permuted_points_give_permuted_velocities(model, rng):
    *motion, action = inputs(rng)
    for x in motion:
        x[:, 110:] = x[:, 90:108]  # a partial cloud repeats points
    order = torch.cat([torch.randperm(80, generator=rng), 80 + torch.randperm(48, generator=rng)])
    a = model(*motion, action, LAYOUT)
    b = model(*(x[:, order] for x in motion), action, LAYOUT)
    torch.testing.assert_close(a[:, order], b, atol=1e-5, rtol=0)
    assert torch.equal(a[:, 110:], a[:, 90:108])
    assert a.std() > 1e-4


@torch.no_grad()
def test_scenes_do_not_see_each_other(model, rng):
    data = inputs(rng, 3)
    data[0][1] *= 0.3
    together = model(*data, LAYOUT)
    alone = torch.cat([model(*(x[[b]] for x in data), LAYOUT) for b in range(3)])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=0)


@torch.no_grad()
def test_place_on_the_table_does_not_matter(model, rng):
    points, *rest = inputs(rng)
    # Multiples of 2^-12 m, so that the shifted points lie in the same cells exactly.
    points = (points * 4096).round() / 4096
    shift = torch.tensor([0.5, -0.25, 0.0])
    torch.testing.assert_close(model(points, *rest, LAYOUT), model(points + shift, *rest, LAYOUT), atol=1e-5, rtol=0)
    higher = model(points + torch.tensor([0.0, 0.0, 0.5]), *rest, LAYOUT)
    assert (higher - model(points, *rest, LAYOUT)).abs().max() > 1e-5


@torch.no_grad()
@pytest.mark.parametrize("registers", [0, 1, 2])
def test_registers_decide_whether_points_attend_to_the_action_alike(rng, registers):
    torch.manual_seed(0)
    config = replace(SMALL, registers=registers, self_layers=0)
    model = PaperModel(LAYOUT, FOUR, config=config).eval()
    attended = []
    model.conditioning.cross[0].out.register_forward_hook(lambda module, args, out: attended.append(out))
    model(*inputs(rng), LAYOUT)
    spread = attended[0][0].std(0).max()
    assert (spread > 1e-6) == (registers > 0)


def test_gradients_reach_every_parameter(model, rng):
    model(*inputs(rng), LAYOUT).square().sum().backward()
    silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert silent == []


def test_learns_one_batch(rng):
    torch.manual_seed(0)
    model = PaperModel(LAYOUT, FOUR, config=replace(SMALL, drop_path=0.0))
    points, velocity, previous, action = inputs(rng)
    target = 0.01 * (action[:, None, :3] + points.flip(-1) / 0.15)
    optimiser = torch.optim.AdamW(model.parameters(), lr=4e-3)
    losses = []
    for _ in range(60):
        loss = (model(points, velocity, previous, action, LAYOUT) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0] / 5


def test_trains_through_a_rollout(rng):
    torch.manual_seed(0)
    model = PaperModel(LAYOUT, FOUR, config=SMALL).train()
    points = inputs(rng)[0]
    state = PointState(LAYOUT, points, points.unsqueeze(1).expand(-1, 3, -1, -1))
    final = rollout(model, state, torch.zeros(2, 3, 4)).points()[:, -1]
    final.sum().backward()
    assert all(p.grad is None or p.grad.isfinite().all() for p in model.parameters())


@torch.no_grad()
def test_bfloat16_is_close(model, rng):
    data = inputs(rng)
    exact = model(*data, LAYOUT)
    model.config = replace(SMALL, bf16=True)
    rough = model(*data, LAYOUT)
    assert rough.dtype == torch.float32
    assert (rough - exact).abs().mean() < 0.1 * exact.abs().mean()


@torch.no_grad()
def test_what_is_not_finite_stays_in_its_scene(model, rng):
    points, *rest = inputs(rng)
    expected = model(points, *rest, LAYOUT)
    points[0, 3] = float("nan")
    points[0, 90] = 1e30
    torch.testing.assert_close(model(points, *rest, LAYOUT)[1], expected[1], atol=1e-5, rtol=0)


def test_config_survives_json():
    assert PaperConfig(**json.loads(json.dumps(asdict(SMALL)))) == SMALL
