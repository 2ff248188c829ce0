"""Registries of cost functions, success rules and grasp rules on point clouds.

All three read ``(points, info)``: ``points[name]`` are an entity's world-frame points (B, n, 3) in metres, and ``info``
holds ``goal`` (B, G), ``action`` (B, A), ``grasped`` (B,), ``velocity[name]`` (B, n, 3) in metres a step, ``joints``
(B, 2, J) with the robot's positions and velocities a step (None where they are not known), and ``extra`` with
``goal_pos`` (B, G). Costs of long tasks also read ``info["stage"]`` (B,), :mod:`pwm_gym.costs.stages`.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, Self, TypeVar

import torch
from torch import Tensor

from pwm_gym.costs.expressions import is_sum, parse_sum
from pwm_gym.errors import PwmGymError, UnknownEntityError, look_up
from pwm_gym.scene import EntityPoints, RigidState, State

__all__ = [
    "COSTS",
    "GRASPS",
    "SUCCESSES",
    "Cost",
    "Points",
    "cost_info",
    "get_cost",
    "get_grasp",
    "get_success",
    "register_cost",
    "register_grasp",
    "register_success",
    "register_terms",
]

Points = Mapping[str, Tensor]
Info = Mapping[str, Any]
Function = Callable[..., Tensor]
F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Cost:
    """A checked cost: a weighted sum of named terms (a plain function is one term of its own name)."""

    name: str
    terms: Mapping[str, tuple[float, Function]]
    """Term -> weight and function."""

    def __call__(self, points: Points, info: Info) -> Tensor:
        """Cost (B,); errors as in :meth:`evaluate`."""
        return torch.stack(list(self.evaluate(points, info).values())).sum(0)

    def evaluate(self, points: Points, info: Info) -> dict[str, Tensor]:
        """Weighted terms by name, each (B,); their sum is the cost.

        Raises:
            PwmGymError: an entity that the scene lacks, a wrong shape, or values that are not finite.
        """
        return self._weighted(self.terms, points, info)

    def _weighted(self, terms: Mapping[str, tuple[float, Function]], points: Points, info: Info) -> dict[str, Tensor]:
        return {n: w * self._checked(n, f, points, info) for n, (w, f) in terms.items()}

    def plus(self, terms: Mapping[str, tuple[float, Function]]) -> Self:
        """This cost with further weighted terms.

        Raises:
            ValueError: it has a term of that name already.
        """
        if taken := sorted({*terms} & {*self.terms}):
            raise ValueError(f"cost {self.name!r} has a term {taken[0]!r} already")
        return replace(self, terms={**self.terms, **terms})

    def __mul__(self, weight: float) -> Cost:
        """This cost, every term ``weight`` times as heavy.

        Raises:
            PwmGymError: a weight that is not finite, or a sequence of stages.
        """
        self._check_plain()
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not math.isfinite(weight):
            raise PwmGymError(f"weight {weight!r} of cost {self.name!r}; expected a finite number")
        if weight == 1:
            return self
        return Cost(f"{weight:g} * {self.name}", {name: (weight * w, f) for name, (w, f) in self.terms.items()})

    __rmul__ = __mul__

    def __add__(self, other: Cost) -> Cost:
        """The sum of both; of a term that both have the second is called after its cost.

        Raises:
            PwmGymError: one of them is a sequence of stages.
        """
        if not isinstance(other, Cost):
            return NotImplemented
        self._check_plain()
        other._check_plain()
        terms = dict(self.terms)
        for name, term in other.terms.items():
            terms[f"{other.name}: {name}" if name in terms else name] = term
        return Cost(f"{self.name} + {other.name}", terms)

    def _check_plain(self) -> None:
        if type(self) is not Cost:
            raise PwmGymError(f"cost {self.name!r} is a sequence of stages; only plain costs can be weighted and added")

    def _checked(self, name: str, function: Function, points: Points, info: Info) -> Tensor:
        batch = len(info["action"])
        try:
            value = function(points, info)
        except UnknownEntityError as error:
            raise PwmGymError(f"cost {self.name!r}: {error}") from error
        except PwmGymError:
            raise
        except Exception as error:  # of a user's function: whatever it may be, it says which cost failed
            raise PwmGymError(f"cost {self.name!r} ({name}) failed: {type(error).__name__}: {error}") from error
        if not isinstance(value, Tensor) or value.shape != (batch,):
            shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise PwmGymError(f"cost {self.name!r} ({name}) returned {shape}; expected a tensor ({batch},)")
        if value.is_complex():
            raise PwmGymError(f"cost {self.name!r} ({name}) returned {value.dtype}; expected real values")
        if not torch.isfinite(value).all():
            count = int((~torch.isfinite(value)).sum())
            raise PwmGymError(f"cost {self.name!r} ({name}) returned {count} of {batch} values not finite")
        return value


COSTS: dict[str, Cost] = {}
"""Name -> cost."""
SUCCESSES: dict[str, Function] = {}
"""Name -> success rule, (points, info) -> bool (B,)."""
GRASPS: dict[str, Function] = {}
"""Name -> grasp rule, (points, info) -> bool (B,)."""


def register_cost(name: str, batched: bool = True) -> Callable[[F], F]:
    """Decorator that registers a cost function under ``name``.

    Args:
        name: what ``gym.make(..., cost=name)`` takes.
        batched: whether the function maps a batch to (B,). Otherwise it is called for each element with points (n, 3)
            and returns a scalar; it may take a first argument ``cfg`` with ``cfg.device``, as the paper's listing does.

    Raises:
        PwmGymError: the name is none, or what is registered no function.
        ValueError: the name is taken.

    Example:
        >>> @register_cost("lift_doctest")
        ... def lift(points, info):
        ...     return -points["cube"].mean(-2)[..., 2]
    """

    def register(function: F) -> F:
        if not callable(function):
            raise PwmGymError(f"cost {name!r} is {function!r}; expected a function of points and info")
        register_terms(name, {name: (1.0, function if batched else _each(function))})
        return function

    return register


def register_terms(name: str, terms: Mapping[str, tuple[float, Function]]) -> Cost:
    """Register a cost that is a weighted sum of named terms, each of which is logged in ``info["cost_terms"]``.

    Raises:
        PwmGymError: the name is none.
        ValueError: the name is taken.
    """
    check_name("cost", name, COSTS)
    COSTS[name] = Cost(name, dict(terms))
    return COSTS[name]


def get_cost(cost: str | Function | Cost) -> Cost:
    """The cost called ``cost``, a weighted sum such as ``"0.7 * reach + 0.3 * place"``, or a callable's checked cost.

    Raises:
        UnknownNameError: listing the known costs and the nearest one.
        PwmGymError: a sum that cannot be read, or one of a sequence of stages.
    """
    if isinstance(cost, Cost):
        return cost
    if callable(cost):
        name = getattr(cost, "__name__", "cost")
        return Cost(name, {name: (1.0, cost)})
    if isinstance(cost, str) and cost not in COSTS and is_sum(cost):
        parts = [weight * look_up("cost", name, COSTS) for weight, name in parse_sum(cost)]
        return sum(parts[1:], start=parts[0])
    return look_up("cost", cost, COSTS)


def register_success(name: str) -> Callable[[F], F]:
    """Decorator that registers a success rule."""
    return _register(SUCCESSES, "success rule", name)


def register_grasp(name: str) -> Callable[[F], F]:
    """Decorator that registers a grasp rule."""
    return _register(GRASPS, "grasp rule", name)


def get_success(name: str) -> Function:
    """The success rule called ``name``."""
    return look_up("success rule", name, SUCCESSES)


def get_grasp(name: str) -> Function:
    """The grasp rule called ``name``."""
    return look_up("grasp rule", name, GRASPS)


def cost_info(state: State, action: Tensor, goal: Tensor, grasp: Function) -> tuple[Points, dict[str, Any]]:
    """What a cost reads of states (B,), the actions (B, A) that led there and goals (B, G).

    All of it is the reader's own: a cost that writes into it changes neither the states nor the goals.
    """
    points = EntityPoints(state)
    own_goal = goal.clone()
    joints = state.joints if isinstance(state, RigidState) else None
    info: dict[str, Any] = {
        "goal": own_goal,
        "action": action.clone(),
        "velocity": EntityPoints(state, velocity=True),
        "joints": None if joints is None else joints.clone(),
        "extra": {"goal_pos": own_goal},
    }
    info["grasped"] = grasp(points, info)
    return points, info


def _register(registry: dict[str, Function], kind: str, name: str) -> Callable[[F], F]:
    check_name(kind, name, registry)

    def register(function: F) -> F:
        registry[name] = function
        return function

    return register


def check_name(kind: str, name: Any, taken: Mapping[str, Any]) -> None:
    """Refuse to register what has no name, or one that is taken.

    Raises:
        PwmGymError: ``name`` is none.
        ValueError: it is taken.
    """
    if not isinstance(name, str) or not name:
        raise PwmGymError(f"{kind} {name!r} is to be registered; expected a name")
    if name in taken:
        raise ValueError(f"{kind} {name!r} is registered already")


def _each(function: Function) -> Function:
    """Batched form of a function of one scene."""
    takes_cfg = len(inspect.signature(function).parameters) == 3

    def batched(points: Points, info: Info) -> Tensor:
        goal = info["goal"]
        cfg = (SimpleNamespace(device=goal.device),) if takes_cfg else ()
        values = [function(*cfg, {n: points[n][b] for n in points}, _element(info, b)) for b in range(len(goal))]
        return torch.stack([torch.as_tensor(v, dtype=goal.dtype, device=goal.device) for v in values])

    return batched


def _element(info: Info, b: int) -> dict[str, Any]:
    """``info`` of one element of the batch; goals as plain lists, as a simulator's info has them."""
    return {
        "goal": info["goal"][b],
        "action": info["action"][b],
        "grasped": bool(info["grasped"][b]),
        "velocity": {n: info["velocity"][n][b] for n in info["velocity"]},
        "joints": None if info["joints"] is None else info["joints"][b],
        "extra": {"goal_pos": info["extra"]["goal_pos"][b].tolist()},
    }


@register_grasp("nothing")
def _nothing(points: Points, info: Info) -> Tensor:
    """Nothing is ever held: of robots without a gripper."""
    return torch.zeros(len(info["action"]), dtype=torch.bool, device=info["action"].device)
