"""How what the robot does not drive moves: gates, carriers, free flight."""

from dataclasses import replace

import pytest
import torch
from acting import at_rest, many_actions, moved, on, steps

from pwm_gym.dynamics.compact.gates import gate
from pwm_gym.robots.joints import JointTree

GRAVITY = 9.81


@torch.no_grad()
@pytest.mark.parametrize("name", ["cube", "two arms", "pot", "no arm"])
def test_an_untouched_scene_rests_exactly(worlds, set_gates, name):
    world = worlds[name]
    model, state = set_gates(world.model(), fall=0.0), world.state(1, moving=False)
    for head in (model.robot.slide, *model.robot.heads):  # which a trained model does not use at rest
        head.weight.zero_()
        head.bias.zero_()
    assert moved(steps(model, state, at_rest(world, 50, 1))[-1], state) < 2e-6


@torch.no_grad()
def test_shut_gates_leave_objects_where_they_are_whatever_the_robot_does(worlds, set_gates):
    for name in ("drawer", "lid", "two arms", "pot"):
        world = worlds[name]
        model, state = set_gates(world.model()), world.state()
        last = steps(model, state, many_actions(world, 8))[-1]
        assert moved(last, state, *(e.name for e in state.layout if not e.driven)) < 2e-6
        assert moved(last, state, state.layout.names[0]) > 1e-3


@torch.no_grad()
def test_a_held_object_moves_with_the_hand_exactly(worlds, set_gates):
    world = worlds["cube"]
    model, state = set_gates(world.model(), links=[20.0, -20.0, -20.0]), world.state()
    states = steps(model, state, many_actions(world, 20))
    assert moved(states[-1], state, "hand") > 0.01
    for after in states:
        torch.testing.assert_close(on(after, "hand", "cube"), on(state, "hand", "cube"), atol=5e-6, rtol=0)


@torch.no_grad()
def test_a_held_pot_takes_all_that_hangs_on_it_along(worlds, set_gates):
    world = worlds["pot"]
    model, state = set_gates(world.model(), links=[20.0, -20.0, -20.0]), world.state(moving=False)
    model.movers.head.bias[3:] = 0.0
    names = ("pot", "grip", "cover", "stopper")
    relative = [on(state, "pot", n) for n in names]
    # The joints' own gates take the hand's way along them; shut them by their limits.
    locked = [
        replace(e, joint=replace(e.joint, lower=q, upper=q)) if e.name in ("cover", "stopper") else e
        for e, q in zip(state.layout, positions(state), strict=True)
    ]
    state = replace(state[:1], layout=replace(state.layout, entities=tuple(locked)))
    last = steps(model, state, many_actions(world, 10, 1))[-1]
    assert moved(last, state, "pot") > 0.01
    for name, before in zip(names, relative, strict=True):
        torch.testing.assert_close(on(last, "pot", name), before[:1], atol=2e-5, rtol=0)


def positions(state):
    """Position of each entity's joint in the first scene; 0 where it has none."""
    tree = JointTree(state.layout, [i for i, e in enumerate(state.layout) if e.joint.moves])
    found = dict(zip(tree.moving, tree.positions(state.poses())[0].tolist(), strict=True))
    return [found.get(i, 0.0) for i in range(len(state.layout))]


@torch.no_grad()
def test_what_lies_in_a_drawer_rides_on_it(worlds, set_gates, new_body):
    """Articulated parts carry: a hand pulls the drawer, and the cube in it goes along."""
    world = worlds["drawer"]
    model, state = set_gates(world.model(), links=-20.0, others=[-20.0, -20.0, 20.0, -20.0]), world.state(moving=False)
    model.movers.head.bias[3:] = torch.tensor([0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    model.movers.head.weight[3:] = 0.0
    place = state.layout.index("cube")
    frames = state.frames.clone()
    frames[:, :, place] = frames[:, :, state.layout.index("drawer")]
    state = replace(state, frames=frames)
    model.movers.head.bias[0] = 20.0  # the learned motion slides the drawer by 4 mm a step ...
    last = steps(model, state, at_rest(world, 3))[-1]
    slid = (last.poses() - state.poses())[:, state.layout.index("drawer"), :3, 3].norm(dim=-1)
    torch.testing.assert_close(slid, torch.full((2,), 0.012), atol=1e-4, rtol=0)
    # ... and the cube by as much, besides its own learned 4 mm in the hand's frame
    own = last.poses()[:, 0, :3, :3] @ torch.tensor([0.012, 0.0, 0.0])
    went = (last.poses() - state.poses())[:, place, :3, 3] - own
    along = (last.poses() - state.poses())[:, state.layout.index("drawer"), :3, 3]
    torch.testing.assert_close(went, along, atol=1e-4, rtol=0)


@torch.no_grad()
def test_an_object_in_free_flight_falls_and_goes_on_turning(worlds, set_gates):
    world, count = worlds["cube"], 4
    model, state = set_gates(world.model(), flying=20.0), world.state()
    frames = state.frames.clone()
    frames[:, :, 3, :2, 3] += 1.0  # away from the hand
    frames[:, :, 3, 2, 3] += 1.0
    state = replace(state, frames=frames)
    cube = state.layout["cube"]
    middle = state.clouds[:, cube.slice][:, : model.config.points].mean(1)

    def centre(poses):
        return (poses[:, 3, :3, :3] @ middle.unsqueeze(-1)).squeeze(-1) + poses[:, 3, :3, 3]

    start, before = (centre(state.frames[:, k]) for k in (0, 1))
    rotation = state.frames[:, 0, 3, :3, :3]
    turn = rotation @ state.frames[:, 1, 3, :3, :3].transpose(1, 2)
    for _ in range(count):
        rotation = turn @ rotation
    last = steps(model, state, many_actions(world, count))[-1].poses()
    expected = start + count * (start - before)
    expected[:, 2] -= GRAVITY * world.control.period**2 * count * (count + 1) / 2
    torch.testing.assert_close(centre(last), expected, atol=2e-5, rtol=0)
    torch.testing.assert_close(last[:, 3, :3, :3], rotation, atol=1e-4, rtol=0)


@torch.no_grad()
@pytest.mark.parametrize("creep", [0.0, 1e-7, 1e-5])
def test_what_rests_on_something_does_not_fall(worlds, set_gates, new_body, creep):
    """Flight gates are open: on the ground, on a fixed box and on another object nothing falls; in mid-air all does."""
    cube = new_body((0.02, 0.02, 0.02), (0.5, -0.3, 0.02))
    world = worlds["lid"].only("hand", "left_gripper", "right_gripper", "box").plus(
        low=replace(cube, at=(0.9, 0.2, 0.02)),
        above=replace(cube, at=(0.9, 0.2, 0.06)),
        onbox=replace(cube, at=(0.5, -0.3, 0.12)),
        high=replace(cube, at=(0.2, 0.6, 0.5)),
    )  # fmt: skip
    model, state = set_gates(world.model(), flying=20.0), world.state(1, moving=False, spread=0.0)
    objects = [state.layout.index(n) for n in ("low", "above", "onbox", "high")]
    frames = state.frames.clone()
    frames[:, :, objects, :3, :3] = torch.eye(3)
    frames[:, 1:, objects, 2, 3] += creep
    state = replace(state, frames=frames)
    last = steps(model, state, at_rest(world, 12, 1))[-1]
    assert moved(last, state, "low", "above", "onbox") < 2e-6
    first = steps(model, state, at_rest(world, 1, 1))[-1]
    fallen = (state.poses() - first.poses())[0, state.layout.index("high"), 2, 3]
    assert fallen == pytest.approx(GRAVITY * world.control.period**2, abs=2e-5)


def test_gates_reach_zero_and_one_and_keep_their_gradient():
    logit = torch.tensor([-30.0, -3.0, 0.0, 3.0, 30.0], requires_grad=True)
    value = gate(logit)
    assert value[[0, 1, 3, 4]].tolist() == [0.0, 0.0, 1.0, 1.0]
    assert value[2].item() == pytest.approx(0.5)
    value.sum().backward()
    assert (logit.grad[1:4] > 0.01).all()
