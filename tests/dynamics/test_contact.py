"""What contacts tell of the movers, and which points they read."""

from dataclasses import replace

import torch

from pwm_gym.scene import FIXED, Support
from pwm_gym.scene.se3 import make_pose


def contacts_of(model, state, action):
    seen = []
    hook = model.contact.register_forward_hook(lambda module, given, told: seen.append(told))
    model.step(model.prepare(state), action)
    hook.remove()
    return seen[0]


@torch.no_grad()
def test_contacts_tell_who_touches_whom_and_the_way_out(worlds, new_body):
    world = worlds["no arm"].only("cube").plus(table=new_body((0.2, 0.2, 0.05), (0.6, 0.0, 0.3), FIXED))
    world = replace(world, points=60)
    model = world.model(points=60)
    start = world.state(1, moving=False, spread=0.0)

    def at(height):
        frames = start.frames.clone()
        frames[:, :, 0] = make_pose(torch.eye(3), torch.tensor([0.6, 0.0, height]))
        return contacts_of(model, replace(start, frames=frames), world.actions(1))

    inside, touching, apart = at(0.367), at(0.3701), at(0.6)  # the table's top is at 0.35, half the cube is 0.02
    torch.testing.assert_close(inside.push[0, 0, 1], torch.tensor([0.0, 0.0, 0.003]), atol=1e-6, rtol=0)
    assert (touching.push == 0).all() and (apart.push == 0).all()
    assert (inside.push[:, :, 0] == 0).all()  # itself
    assert inside.unsupported.item() == touching.unsupported.item() == 0.0 and apart.unsupported.item() == 1.0
    gap, gap_next = 0, 1
    assert inside.pairs[0, 0, 1, gap_next] < -0.3 < 0.1 > touching.pairs[0, 0, 1, gap].abs()
    assert apart.pairs[0, 0, 1, gap] > 0.99


@torch.no_grad()
def test_walls_are_touched(worlds, new_body):
    """A fixed box of the world without points: what it says is what a fixed entity says."""
    world = worlds["no arm"].only("cube")
    start = world.state(1, moving=False, spread=0.0)
    shelf = Support((0.6, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0), (0.2, 0.2, 0.05))
    model = world.model()
    for height, expected in ((0.371, 0.0), (0.5, 1.0)):
        frames = start.frames.clone()
        frames[:, :, 0] = make_pose(torch.eye(3), torch.tensor([0.6, 0.0, height]))
        layout = replace(start.layout, supports=(Support.ground(), shelf))
        state = replace(start, layout=layout, frames=frames)
        assert contacts_of(model, state, world.actions(1)).unsupported.item() == expected


@torch.no_grad()
def test_half_of_a_movers_points_are_those_nearest_to_what_may_touch_it(worlds):
    world = replace(worlds["cube"], points=64)
    model, state = world.model(points=8, searched=64), world.state(2)
    read, local, half = points_of(model, state, world.actions(2))
    mover = state.layout.index("cube")
    cloud = state.clouds[:, state.layout.entities[mover].slice]
    torch.testing.assert_close(read[:, mover, :3, :4], cloud[:, :4].mT)
    gaps, chosen = (gaps_to_boxes(points, local, half) for points in (cloud, read[:, mover, :3, 4:].mT))
    torch.testing.assert_close(chosen.sort().values, gaps.topk(4, largest=False).values)
    torch.testing.assert_close(
        read[:, :mover, :3], model._shapes(state, model.plan(state.layout)).points[:, :mover, :3]
    )
    few = replace(state, layout=state.layout)
    plain, _, _ = points_of(world.model(points=8, searched=0), few, world.actions(2))
    torch.testing.assert_close(plain[:, mover, :3], cloud[:, :8].mT)


def points_of(model, state, action):
    """Points (B, P, 4, n) that a step reads, and the maps and half boxes that they were chosen by."""
    seen, look = [], model.contact._look_closer

    def spy(plan, shapes, local, half):
        seen.append((look(plan, shapes, local, half), local, half))
        return seen[-1][0]

    model.contact._look_closer = spy
    model.step(model.prepare(state), action)
    return seen[0]


def gaps_to_boxes(points, local, half):
    """Chebyshev gaps (B, n) of a mover's points (B, n, 3) to the nearest of its partners' boxes."""
    maps = local[:, 0].transpose(1, 2)  # (B, P, 3, 4)
    places = torch.einsum("bpij,bnj->bpni", maps[..., :3], points) + maps[:, :, None, :, 3]
    return (places.abs() - half[:, : maps.shape[1], None]).amax(-1).amin(1)
