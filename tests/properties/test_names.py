"""Registries by name: what is known is found, what is not is told with the nearest one, and nothing is replaced."""

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from pwm_gym.costs import COSTS, get_cost, register_cost
from pwm_gym.dynamics.registry import MODELS, model_kind
from pwm_gym.errors import PwmGymError, UnknownNameError, check_seed, check_whole, look_up
from pwm_gym.planning import get_planner_config
from pwm_gym.tasks import TASKS, get_task

REGISTRIES = {"cost": (COSTS, get_cost), "task": (TASKS, get_task), "model": (MODELS, model_kind)}
things = st.text(max_size=30) | st.integers() | st.none() | st.floats() | st.lists(st.integers(), max_size=3)


@pytest.mark.parametrize("kind", REGISTRIES)
@given(thing=things)
def test_what_no_registry_holds_is_one_error(kind, thing):
    known, get = REGISTRIES[kind]
    assume(not isinstance(thing, str) or thing not in known)
    with pytest.raises(PwmGymError) as error:
        get(thing)
    assert repr(thing) in str(error.value) or str(thing) in str(error.value)


@pytest.mark.parametrize("kind", REGISTRIES)
@given(data=st.data())
def test_a_name_with_a_slip_is_told_the_right_one(kind, data):
    known, get = REGISTRIES[kind]
    name = data.draw(st.sampled_from(sorted(known)))
    place = data.draw(st.integers(0, len(name) - 1))
    slip = name[:place] + data.draw(st.sampled_from("xqz")) + name[place + 1 :]
    assume(slip not in known)
    with pytest.raises(UnknownNameError, match="Did you mean '"):
        get(slip)


@given(st.text(max_size=20))
def test_planners_too(name):
    try:
        assert get_planner_config(name).samples > 0
    except UnknownNameError as error:
        assert "mppi" in str(error)


@given(st.dictionaries(st.text(max_size=8), st.integers(), max_size=5), st.text(max_size=8))
def test_looking_up_is_indexing(known, name):
    if name in known:
        assert look_up("thing", name, known) == known[name]
    else:
        with pytest.raises(UnknownNameError, match="unknown thing"):
            look_up("thing", name, known)


@given(st.text(min_size=1, max_size=20))
def test_a_name_is_taken_once(name):
    assume(name not in COSTS)
    try:
        first = register_cost(name)(lambda points, info: torch.zeros(len(info["action"])))
        with pytest.raises(ValueError, match="is registered already"):
            register_cost(name)(lambda points, info: torch.ones(len(info["action"])))
        assert COSTS[name].terms[name][1] is first and get_cost(name) is COSTS[name]
    finally:
        COSTS.pop(name, None)


@given(st.integers() | st.floats() | st.booleans() | st.text(max_size=3) | st.none())
def test_whole_numbers_and_seeds(value):
    whole = isinstance(value, int) and not isinstance(value, bool)
    for check, low, high in ((check_seed, 0, 2**63 - 1), (lambda x: check_whole("n", x, 3, 9), 3, 9)):
        if whole and low <= value <= high:
            assert check(value) == value
        else:
            with pytest.raises(PwmGymError, match="expected a whole number from"):
                check(value)
