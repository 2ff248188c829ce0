from dataclasses import replace

import pytest
import torch

from pwm_gym.costs import FINISHED, STAGES_LEFT, UNDONE, Stage, StagedCost, get_cost, register_stages
from pwm_gym.costs.registry import COSTS
from pwm_gym.errors import PwmGymError
from pwm_gym.scene import EntityPoints, batch_state


def at(name, least):
    """Rule: the first coordinate of an entity's first point is at least this."""
    return lambda points, info: points[name][:, 0, 0] >= least


def value(name):
    return lambda points, info: points[name][:, 0, 0]


GO = Stage("go", {"far": (2.0, value("a"))}, at("a", 1.0))
COME = Stage("come", {"near": (-1.0, value("b")), "far": (3.0, value("a"))}, at("b", 1.0))
COST = StagedCost("trip", {"always": (1.0, value("b"))}, (GO, COME), price=10.0)


def scenes(a, b):
    """Points and info of scenes whose two entities have these first coordinates."""
    points = {k: torch.tensor(v).view(-1, 1, 1).repeat(1, 1, 3).float() for k, v in (("a", a), ("b", b))}
    return points, {"action": torch.zeros(len(a), 1)}


def test_the_present_stages_terms_count_and_each_stage_that_is_left_has_a_price():
    points, info = scenes([0.5, 2.0, 3.0], [0.2, 0.4, 5.0])
    told = COST.evaluate(points, {**info, "stage": torch.tensor([0, 1, 2])})
    assert list(told) == ["always", STAGES_LEFT, "go: far", "come: near", "come: far"]
    expected = {
        "always": [0.2, 0.4, 5.0],
        STAGES_LEFT: [20.0, 10.0, 0.0],
        "go: far": [1.0, 0.0, 0.0],
        "come: near": [0.0, -0.4, 0.0],
        "come: far": [0.0, 6.0, 0.0],
    }
    for name, values in expected.items():
        torch.testing.assert_close(told[name], torch.tensor(values))
    torch.testing.assert_close(COST(points, {**info, "stage": torch.tensor([0, 1, 2])}), sum(told.values()))


def test_every_element_moves_on_by_itself_and_never_goes_back():
    # Three sequences of four scenes: a passes 1 and falls back; all at once in one scene; begun in the second stage.
    points, info = scenes([0, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0], [0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 1, 0])
    found = COST.along(torch.tensor([0, 0, 1]), points, info, 4)
    assert found.tolist() == [[0, 1, 1, 2], [0, 2, 2, 2], [1, 1, 2, 2]]
    first = {k: v.view(3, 4, 1, 3)[:, 1] for k, v in points.items()}
    assert COST.advance(torch.tensor([0, 0, 1]), first, info).tolist() == [1, 2, 1]


def test_a_stage_that_is_over_later_does_not_count_before_the_one_before_it():
    points, info = scenes([0, 0, 1, 0], [1, 0, 0, 0])
    assert COST.along(COST.begin(1), points, info, 4).tolist() == [[0, 0, 1, 1]]


def test_a_stage_whose_lasting_rule_is_broken_begins_anew_and_costs_its_price():
    cost = StagedCost("kept", {}, (replace(GO, lasting=at("a", 0.5)), COME, GO.renamed("again")), price=10.0)
    points, info = scenes([0.2, 0.6, 0.2, 0.2], [0.0, 0.0, 2.0, 0.0])
    stage = torch.tensor([1, 1, 1, 0])
    told = cost.evaluate(points, {**info, "stage": stage})
    assert told[UNDONE].tolist() == [10.0, 0.0, 10.0, 0.0]
    assert cost.advance(stage, points, info).tolist() == [0, 1, 0, 0]
    assert cost.along(stage, points, info, 1).flatten().tolist() == [1, 1, 2, 0]  # not inside a rollout
    assert UNDONE not in COST.evaluate(points, {**info, "stage": stage})


def test_rules_of_stages_that_nothing_has_come_to_are_not_asked():
    def never(points, info):
        pytest.fail("asked")

    cost = StagedCost("lazy", {}, (GO, Stage("later", {"far": (1.0, never)}, never)))
    points, info = scenes([0.0, 0.5], [0.0, 0.0])
    assert cost.along(cost.begin(2), points, info, 1).tolist() == [[0], [0]]
    assert cost(points, info).tolist() == [40.0, 41.0]  # no stage told: the first one


def test_it_has_gradients_of_the_present_stage_alone():
    points, info = scenes([0.5, 2.0], [0.2, 0.4])
    leaves = {name: cloud.requires_grad_() for name, cloud in points.items()}
    COST(leaves, {**info, "stage": torch.tensor([0, 1])}).sum().backward()
    assert leaves["a"].grad[:, 0, 0].tolist() == [2.0, 3.0]
    assert leaves["b"].grad[:, 0, 0].tolist() == [1.0, 0.0]


def test_further_terms_keep_the_stages():
    more = COST.plus({"a": (1.0, value("a"))})
    assert more.stages == COST.stages and more.price == COST.price and list(more.terms) == ["always", "a"]


def test_sequences_concatenate_and_are_found_by_name():
    try:
        cost = register_stages("trip_twice", [*COST.stages, *(s.renamed(f"{s.name} again") for s in COST.stages)])
        assert get_cost("trip_twice") is cost
        assert cost.stage_names == ("go", "come", "go again", "come again", FINISHED)
        with pytest.raises(ValueError, match="'trip_twice' is registered already"):
            register_stages("trip_twice", COST.stages)
    finally:
        del COSTS["trip_twice"]


@pytest.mark.parametrize(
    ("stages", "more", "message"),
    [
        ((), {}, "cost 'bad' has no stages; expected at least one"),
        ((GO, GO), {}, "cost 'bad' has a second stage 'go'; expected names that differ"),
        ((GO.renamed(FINISHED),), {}, "a second stage 'finished'"),
        ((GO, Stage("stay", {}, None)), {}, "stage 'stay' has no end"),
        ((GO,), {"price": 0.0}, "price=0.0; expected more than 0"),
    ],
)
def test_sequences_that_cannot_be_are_refused(stages, more, message):
    with pytest.raises(PwmGymError, match=message):
        StagedCost("bad", {}, stages, **more)


def test_what_a_scene_lacks_and_stages_beyond_the_last_are_named(scene):
    lid = StagedCost("brew", {}, (Stage("close lid", {}, at("lid", 1.0)),))
    points, info = EntityPoints(batch_state([scene])), {"action": torch.zeros(1, 7)}
    with pytest.raises(PwmGymError, match="cost 'brew', stage 'close lid': .*lid"):
        lid(points, info)
    few, told = scenes([0.0], [0.0])
    with pytest.raises(PwmGymError, match=r"stages \[3\]; expected values from 0 to 2"):
        COST.advance(torch.tensor([3]), few, told)
