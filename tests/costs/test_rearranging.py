"""Which cube is next and where it goes, and that each move of a plan is worth it: on clouds of cubes alone."""

import itertools

import pytest
import torch

from pwm_gym.costs.rearranging import Rearranging
from pwm_gym.costs.several import Several

SIDE = 0.04
TABLE = (0.3, -0.3, 0.55, 0.3)
A, B, C = (0.425, -0.1, 0.02), (0.425, 0.1, 0.02), (0.35, 0.2, 0.02)
OVER_A, OVER_B = (*A[:2], 0.06), (*B[:2], 0.06)
ASIDE, FAR = (0.5, 0.0, 0.02), (0.5, 0.25, 0.02)


def raised(place, height=0.1):
    return (*place[:2], height)


def cloud(place):
    """Corners (8, 3) of a cube."""
    corners = torch.tensor(list(itertools.product((-0.5, 0.5), repeat=3)))
    return torch.tensor(place) + SIDE * corners


def scene(*places, goals):
    """Points and info of cubes a, b, ... at their places."""
    points = {name: cloud(place)[None] for name, place in zip("abcd", places, strict=False)}
    return points, {"goal": torch.tensor([value for goal in goals for value in goal])[None]}


def rules(count=2):
    return Rearranging(Several(tuple("abcd"[:count]), 0.02), SIDE, TABLE)


def plan(*steps, goals):
    """Moves that are left, next cube, and where it goes, of each scene of a plan."""
    told = rules(len(goals))
    found = []
    for places in steps:
        points, info = scene(*places, goals=goals)
        number = int(told.next(points, info))
        place = told.target("abcd"[number])(points, info)[0]
        found.append((float(told.moves(points, info)), "abcd"[number], place))
    return found


def check(steps, goals, wanted):
    """Each scene's moves and next cube, which goes to its own goal or to a free place aside."""
    for places, (moves, name, place), (its_moves, its_name, where) in zip(
        steps, plan(*steps, goals=goals), wanted, strict=True
    ):
        assert (moves, name) == (its_moves, its_name), places
        own = torch.tensor(goals["abcd".index(name)])
        assert bool((place - own).norm() < 1e-6) == (where == "goal"), places
        if where == "aside":
            others = [torch.tensor(p) for k, p in enumerate((*goals, *places)) if k != len(goals) + "abcd".index(name)]
            assert min(float((place - p)[:2].norm()) for p in others) > 0.08
            assert place[2] == pytest.approx(0.02) and 0.3 <= place[0] <= 0.55 and -0.3 <= place[1] <= 0.3


def test_a_swap_puts_one_cube_aside_before_the_other_goes():
    """In the air, and wherever it is there, the cube that is put aside goes on."""
    steps = [
        (A, B),
        (raised(A), B),
        (raised(ASIDE, 0.06), B),
        (ASIDE, B),
        (ASIDE, raised(B)),
        (ASIDE, raised(A)),
        (ASIDE, A),
    ]
    steps += [(raised(ASIDE), A), (B, A)]
    wanted = [(3, "a", "aside")] * 3 + [(2, "b", "goal")] * 3 + [(1, "a", "goal")] * 2 + [(0, "a", "goal")]
    check(steps, (B, A), wanted)


def test_a_stack_is_built_from_below():
    steps = [(A, C), (A, raised(C)), (A, B), (raised(A), B), (OVER_B, B)]
    check(steps, (OVER_B, B), [(2, "b", "goal")] * 2 + [(1, "a", "goal")] * 2 + [(0, "b", "goal")])


def test_a_stack_is_taken_down_from_above():
    check(
        [(A, OVER_A), (A, raised(A)), (A, FAR), (C, FAR)],
        (C, FAR),
        [(2, "b", "goal")] * 2 + [(1, "a", "goal"), (0, "a", "goal")],
    )


def test_a_stack_is_turned_over_by_way_of_two_places_aside():
    steps = [
        (A, OVER_A),
        (A, raised(A, 0.12)),
        (A, FAR),
        (raised(A), FAR),
        (C, FAR),
        (C, raised(FAR)),
        (C, A),
        (OVER_A, A),
    ]
    wanted = (
        [(4, "b", "aside")] * 2
        + [(3, "a", "aside")] * 2
        + [(2, "b", "goal")] * 2
        + [(1, "a", "goal"), (0, "b", "goal")]
    )
    check(steps, (OVER_A, A), wanted)


def test_a_cube_on_top_whose_goal_is_beneath_waits_aside():
    """The lower cube goes elsewhere; the upper one takes its place."""
    steps = [(A, OVER_A), (A, FAR), (C, FAR), (C, A)]
    check(steps, (C, A), [(3, "b", "aside"), (2, "a", "goal"), (1, "b", "goal"), (0, "a", "goal")])


def test_a_cube_in_the_way_that_has_a_free_goal_goes_there():
    check(
        [(A, B), (raised(A), B), (A, C), (B, C)],
        (B, C),
        [(2, "b", "goal"), (3, "a", "aside"), (1, "a", "goal"), (0, "a", "goal")],
    )


def test_a_cube_in_hand_that_may_go_to_its_goal_is_not_let_go_for_another():
    check([(A, raised(B))], (C, FAR), [(2, "b", "goal")])


def test_a_ring_of_three_needs_one_cube_aside_and_two_swaps_two():
    check([(A, B, C), (ASIDE, B, C)], (B, C, A), [(4, "a", "aside"), (3, "c", "goal")])
    points, info = scene(A, B, C, FAR, goals=(B, A, FAR, C))
    assert float(rules(4).moves(points, info)) == 6.0


def test_a_settled_cube_on_one_that_has_to_move_is_put_aside():
    steps = [(A, OVER_A, B), (A, FAR, B), (C, FAR, B), (C, FAR, A), (C, OVER_A, A)]
    wanted = [(4, "b", "aside"), (3, "a", "goal"), (2, "c", "goal"), (1, "b", "goal"), (0, "a", "goal")]
    check(steps, (C, OVER_A, A), wanted)


def test_scenes_of_a_batch_are_told_apart():
    told = rules()
    several = [scene(A, B, goals=(B, A)), scene(ASIDE, B, goals=(B, A)), scene(B, A, goals=(B, A))]
    points = {name: torch.cat([p[name] for p, _ in several]) for name in "ab"}
    info = {"goal": torch.cat([i["goal"] for _, i in several])}
    assert told.moves(points, info).tolist() == [3.0, 2.0, 0.0]
    which = told.of_next(lambda name, place: lambda points, info: torch.full((3,), float(name == "b")))
    assert which(points, info).tolist()[:2] == [0.0, 1.0]
    heights = told.of_next(lambda name, place: lambda points, info: place(points, info)[:, 1])
    assert heights(points, info)[1] == pytest.approx(A[1])
