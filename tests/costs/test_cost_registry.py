import pytest
import torch

from pwm_gym.costs import (
    COSTS,
    contacts,
    cost_info,
    get_cost,
    get_grasp,
    get_success,
    register_cost,
    register_grasp,
    register_success,
    register_terms,
)
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.scene import Layout, PointState, RigidState
from pwm_gym.tasks import TASKS

LAYOUT = Layout.build([("hand", 8), ("left_gripper", 8), ("right_gripper", 8), ("cube", 8)], ("hand",))


def random_scenes(layout, goal_size, action_size):
    """Points and info of three random scenes, the first of which is grasped."""
    generator = torch.Generator().manual_seed(0)
    clouds = 0.05 * torch.randn(3, layout.points, 3, generator=generator)
    frames = torch.eye(4).repeat(3, 3, len(layout), 1, 1)
    frames[..., :3, 3] = torch.randn(3, 3, len(layout), 3, generator=generator)
    action, goal = torch.randn(3, action_size, generator=generator), torch.randn(3, goal_size, generator=generator)
    return cost_info(RigidState(layout, clouds, frames), action, goal, lambda p, i: torch.tensor([True, False, False]))


@pytest.fixture
def view():
    """Three random scenes of one cube."""
    return random_scenes(LAYOUT, 3, 7)


def height(points, info):
    return points["cube"].mean(-2)[..., 2]


def test_info_holds_what_the_design_promises(view):
    points, info = view
    assert list(points) == list(LAYOUT.names)
    assert info["extra"]["goal_pos"] is info["goal"] and info["action"].shape == (3, 7)
    assert info["velocity"]["cube"].shape == points["cube"].shape == (3, 8, 3)
    assert info["grasped"].tolist() == [True, False, False]


def test_what_terms_derive_is_formed_once_and_the_same(view):
    points, _ = view
    plain = dict(points)
    for term in (contacts.tool_centre, contacts.finger_gaps, contacts.pad_gaps, contacts.centre):
        args = () if term is contacts.tool_centre else ("cube",)
        torch.testing.assert_close(term(points, *args), term(plain, *args))
        assert term(points, *args) is term(points, *args)
        assert term(plain, *args) is not term(plain, *args)
    assert not torch.equal(contacts.centre(points, "cube"), contacts.centre(points, "hand"))


def test_a_registered_cost_is_found_by_name(costs, view):
    assert register_cost("height")(height) is height
    torch.testing.assert_close(get_cost("height")(*view), height(*view))
    assert get_cost("height").evaluate(*view).keys() == {"height"}


def test_a_callable_is_a_cost_too(view):
    assert get_cost(height).name == "height"
    assert get_cost(get_cost(height)).name == "height"
    torch.testing.assert_close(get_cost(height)(*view), height(*view))


def test_terms_are_weighted_and_sum_to_the_cost(costs, view):
    cost = register_terms("two", {"up": (-2.0, height), "far": (0.5, lambda p, i: i["goal"].norm(dim=-1))})
    terms = cost.evaluate(*view)
    torch.testing.assert_close(terms["up"], -2.0 * height(*view))
    torch.testing.assert_close(cost(*view), -2.0 * height(*view) + 0.5 * view[1]["goal"].norm(dim=-1))


@pytest.mark.parametrize("name", sorted(COSTS))
def test_every_registered_costs_terms_sum_to_it(name):
    task = next(t for t in TASKS.values() if name in (t.cost, t.plan_cost))
    view = random_scenes(task.layout, task.goal_size, task.action_size)
    cost = get_cost(name)
    torch.testing.assert_close(sum(cost.evaluate(*view).values()), cost(*view))


@pytest.mark.parametrize(
    ("register", "name"), [(register_cost, "pick_cube"), (register_success, "pick_cube"), (register_grasp, "pick_cube")]
)
def test_a_name_is_taken_once(register, name):
    with pytest.raises(ValueError, match="'pick_cube' is registered already"):
        register(name)(height)


@pytest.mark.parametrize(
    ("get", "kind"), [(get_cost, "cost"), (get_success, "success rule"), (get_grasp, "grasp rule")]
)
def test_an_unknown_name_is_answered_with_the_nearest(get, kind):
    with pytest.raises(UnknownNameError, match=f"unknown {kind} 'pick_cub'; known: .*Did you mean 'pick_cube'"):
        get("pick_cub")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda p, i: p["mug"].mean((-2, -1)), "no entity 'mug'; this scene has hand, left_gripper, .*cube"),
        (lambda p, i: i["nope"], r"\(bad\) failed: KeyError: 'nope'"),
        (lambda p, i: p["cube"].mean(-2), r"returned \(3, 3\); expected a tensor \(3,\)"),
        (lambda p, i: p["cube"].mean(), r"returned \(\); expected a tensor \(3,\)"),
        (lambda p, i: 0.5, "returned float; expected a tensor"),
        (lambda p, i: height(p, i) / torch.tensor([0.0, 1.0, 1.0]), "returned 1 of 3 values not finite"),
        (lambda p, i: height(p, i) * torch.nan, "returned 3 of 3 values not finite"),
    ],
)
def test_a_failing_cost_is_explained(costs, view, function, message):
    register_cost("bad")(function)
    with pytest.raises(PwmGymError, match=f"cost 'bad'.*{message}"):
        get_cost("bad")(*view)


@pytest.mark.parametrize("register", [register_cost, register_success, register_grasp])
@pytest.mark.parametrize("name", [5, None, ""])
def test_what_has_no_name_is_not_registered(register, name):
    with pytest.raises(PwmGymError, match=f"{name!r} is to be registered; expected a name"):
        register(name)(height)


def test_an_unbatched_cost_sees_one_scene_at_a_time(costs, view):
    @register_cost("single", batched=False)
    def single(points, info):
        assert points["cube"].shape == (8, 3) and info["velocity"]["hand"].shape == (8, 3)
        assert isinstance(info["grasped"], bool) and isinstance(info["extra"]["goal_pos"], list)
        return points["cube"].mean(0)[2] if info["grasped"] else 7

    expected = torch.cat([height(*view)[:1], torch.tensor([7.0, 7.0])])
    torch.testing.assert_close(get_cost("single")(*view), expected)


# The paper's listing (appendix "Cost Function"), unchanged.
def cost_fn_pick_cube(cfg, point, info):
    goal_xyz = torch.tensor(info["extra"]["goal_pos"], device=cfg.device)

    left_gripper_xyz = point["left_gripper"]
    right_gripper_xyz = point["right_gripper"]
    cube_xyz = point["cube"]

    cube_center_xyz = cube_xyz.mean(dim=0)
    tcp_xyz = (left_gripper_xyz.mean(dim=0) + right_gripper_xyz.mean(dim=0)) / 2

    tcp_to_cube_dist = torch.norm(cube_center_xyz - tcp_xyz, dim=0)
    reaching_reward = 1.0 - torch.tanh(5.0 * tcp_to_cube_dist)

    cube_to_goal_dist = torch.norm(tcp_xyz - goal_xyz, dim=0)
    place_reward = 1.0 - torch.tanh(5.0 * cube_to_goal_dist)

    contact_reward = 1.0 if info["grasped"] else 0.0

    if info["grasped"]:
        total_cost = -place_reward
    else:
        total_cost = -(reaching_reward + contact_reward)

    return total_cost


def test_the_papers_listing_runs_unchanged(costs, view):
    register_cost("listing", batched=False)(cost_fn_pick_cube)
    points, info = view
    tool = (points["left_gripper"].mean(1) + points["right_gripper"].mean(1)) / 2
    reach = 1 - torch.tanh(5 * (points["cube"].mean(1) - tool).norm(dim=-1))
    place = 1 - torch.tanh(5 * (tool - info["goal"]).norm(dim=-1))
    torch.testing.assert_close(get_cost("listing")(points, info), -torch.where(info["grasped"], place, reach))


@pytest.mark.parametrize("form", [lambda s: s, PointState.of], ids=["rigid", "points"])
def test_what_a_cost_writes_into_is_its_own(form):
    clouds, frames = 0.05 * torch.randn(3, LAYOUT.points, 3), torch.eye(4).repeat(3, 3, 4, 1, 1)
    state = form(RigidState(LAYOUT, clouds, frames, torch.rand(3, 2, 9)))
    goal, action = torch.rand(3, 3), torch.rand(3, 7)
    before = [t.clone() for t in (*state.tensors, goal, action)]
    points, info = cost_info(state, action, goal, get_grasp("pick_cube"))
    written = [info["goal"], info["action"], info["extra"]["goal_pos"], points["cube"], info["velocity"]["cube"]]
    for value in [*written, *([] if info["joints"] is None else [info["joints"]])]:
        value.fill_(7.0)
    for now, then in zip((*state.tensors, goal, action), before, strict=True):
        assert torch.equal(now, then)


def gap(points, info):
    return (points["cube"].mean(-2) - points["hand"].mean(-2)).norm(dim=-1)


def test_costs_are_weighted_and_added_as_objects_and_as_text(costs, view):
    register_cost("of_height")(height)
    register_cost("of_gap")(gap)
    expected = 0.7 * height(*view) - 2.5 * gap(*view)
    summed = 0.7 * get_cost("of_height") + -2.5 * get_cost("of_gap")
    for cost in (summed, get_cost("0.7 * of_height + -2.5 * of_gap"), get_cost(summed)):
        torch.testing.assert_close(cost(*view), expected)
        assert list(cost.terms) == ["of_height", "of_gap"]
    assert summed.name == "0.7 * of_height + -2.5 * of_gap"
    torch.testing.assert_close(get_cost("of_gap + .5 * of_gap")(*view), 1.5 * gap(*view))
    assert list(get_cost("of_gap + .5 * of_gap").terms) == ["of_gap", "0.5 * of_gap: of_gap"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.7 *", r"cost '0.7 \*': cannot read '0.7 \*'; expected e.g."),
        ("2 * 3", "cannot read '2 \\* 3'"),
        ("of_height + ", "cannot read ''; expected e.g."),
        ("of_height + 2 * of_hight", "unknown cost 'of_hight'.*Did you mean 'of_height'"),
        ("0.5 * coffee_plan", "cost 'coffee_plan' is a sequence of stages; only plain costs"),
        ("of_height + coffee_plan", "cost 'coffee_plan' is a sequence of stages; only plain costs"),
        ("1e999 * of_height", "weight inf of cost 'of_height'; expected a finite number"),
    ],
)
def test_sums_that_cannot_be_read(costs, text, message):
    register_cost("of_height")(height)
    with pytest.raises(PwmGymError, match=message):
        get_cost(text)


def test_weights_are_finite_numbers():
    for weight in (float("nan"), True, "2"):
        with pytest.raises(PwmGymError, match=r"weight .* of cost 'pick_cube'; expected a finite number"):
            get_cost("pick_cube") * weight
    with pytest.raises(TypeError):
        get_cost("pick_cube") + 1.0
