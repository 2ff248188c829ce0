"""What both twins' environments share: spaces, observations, checks and the rules of an episode."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from pwm_gym.costs import Cost, StagedCost, cost_info, get_cost, get_grasp, get_success
from pwm_gym.errors import PwmGymError, SceneError, check_seed, unknown_name
from pwm_gym.robots import Control
from pwm_gym.scene import POSE_FEATURES, Layout, PointState, RigidState, Scene, State, pose_features
from pwm_gym.tasks import Task

__all__ = [
    "BOUND",
    "OBSERVATIONS",
    "Judgement",
    "Observation",
    "Rules",
    "action_space",
    "bounded",
    "check_actions",
    "check_mask",
    "check_options",
    "check_render_mode",
    "first_entities",
    "last_action",
    "observation_space",
    "observe",
    "outside",
    "pose_space",
    "poses_of",
    "seeds_of",
    "with_rows",
]

BOUND = 2.0
"""Metres from the base beyond which a prediction has left the world."""
_SPEED = 1.0  # metres a step: bound of velocities


def action_space(size: int) -> spaces.Box:
    """Actions (A,) in [-1, 1], float32."""
    return spaces.Box(-1.0, 1.0, (size,), np.float32)


def observation_space(layout: Layout, goal_size: int) -> spaces.Space[Any]:
    """Dict of points, velocity and previous_velocity (N, 3) and goal (G,), float32, finite bounds."""
    shape = (layout.points, 3)
    return spaces.Dict(
        {
            "points": spaces.Box(-BOUND, BOUND, shape, np.float32),
            "velocity": spaces.Box(-_SPEED, _SPEED, shape, np.float32),
            "previous_velocity": spaces.Box(-_SPEED, _SPEED, shape, np.float32),
            "goal": spaces.Box(-BOUND, BOUND, (goal_size,), np.float32),
        }
    )


def observe(state: State, goal: Tensor) -> dict[str, Tensor]:
    """Observations (B, ...) of a state (B,), clipped to the observation space; fresh tensors."""
    points, velocity, previous = state.motion()
    return {
        "points": points.clamp_(-BOUND, BOUND),
        "velocity": velocity.clamp_(-_SPEED, _SPEED),
        "previous_velocity": previous.clamp_(-_SPEED, _SPEED),
        "goal": goal.clamp(-BOUND, BOUND),
    }


def pose_space(layout: Layout, goal_size: int) -> spaces.Space[Any]:
    """Box (12 E + G,) float32 of the entities' positions, rotations and velocities, and the goal."""
    return spaces.Box(-BOUND, BOUND, (POSE_FEATURES * len(layout) + goal_size,), np.float32)


def poses_of(state: State, goal: Tensor) -> Tensor:
    """Observations (B, 12 E + G) of a state (B,), clipped to :func:`pose_space`; a fresh tensor."""
    return pose_features(state, goal).clamp_(-BOUND, BOUND)


@dataclass(frozen=True)
class Observation:
    """A way to show a state."""

    space: Callable[[Layout, int], spaces.Space[Any]]
    """Space of the scenes of a layout with goals of a size."""
    observe: Callable[[State, Tensor], Any]
    """Observations (B, ...) of a state (B,) and goals (B, G)."""


OBSERVATIONS = {"points": Observation(observation_space, observe), "poses": Observation(pose_space, poses_of)}
"""Name -> what a batch may show."""


def first_entities(state: State, layout: Layout) -> State:
    """The state of the entities of ``layout`` alone, where further ones follow them."""
    if len(state.layout) == len(layout):
        return state
    entities, points = len(layout), layout.points
    clouds = state.clouds[..., :points, :]
    if isinstance(state, RigidState):
        error = None if state.error is None else state.error[..., :entities]
        return replace(state, layout=layout, clouds=clouds, frames=state.frames[..., :entities, :, :], error=error)
    assert isinstance(state, PointState)
    return PointState(layout, clouds, state.frames[..., :points, :])


def outside(state: State) -> Tensor:
    """Bool (B,): something of the state is not finite, or an entity is out of bounds."""
    moving = state.tensors[1:]  # all but the clouds
    finite = torch.stack([torch.isfinite(x.flatten(1)).all(1) for x in moving]).all(0)
    places = state.frames[..., 0, :, :3, 3] if isinstance(state, RigidState) else state.points()
    far = places.abs().flatten(1).amax(1) > BOUND  # NaN is not
    return ~finite | far


def bounded(state: State) -> State:
    """The state with finite values where a prediction left the bounds, so that the returned ones can be clipped."""
    return state.map(lambda x: torch.nan_to_num(x).clamp(-1e3, 1e3))


def check_mask(name: str, mask: Any, count: int) -> np.ndarray:
    """A mask of environments (count,) bool.

    Raises:
        PwmGymError: it is none, naming it.
    """
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (count,):
        found = f"{mask.dtype} {mask.shape}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise PwmGymError(f"{name} is {found}; expected a boolean array ({count},)")
    return mask


def check_actions(actions: Any, shape: tuple[int, ...]) -> Tensor:
    """Actions as a float32 tensor, a copy.

    Raises:
        PwmGymError: wrong shape or dtype, NaN, or a value outside [-1, 1].
    """
    value: Any = actions if isinstance(actions, Tensor) else _array(actions, shape)
    torched = isinstance(value, Tensor)
    if not (value.is_floating_point() if torched else np.issubdtype(value.dtype, np.floating)):
        raise PwmGymError(f"actions have dtype {value.dtype}; expected floating point")
    if tuple(value.shape) != shape:
        raise PwmGymError(f"actions have shape {tuple(value.shape)}; expected {shape}")
    if torched:
        tensor = value.detach().to(torch.float32, copy=True)
    else:
        tensor = torch.from_numpy(value.astype(np.float32))
    if not torch.isfinite(tensor).all():
        raise PwmGymError(f"actions hold {int((~torch.isfinite(tensor)).sum())} values that are not finite")
    if tensor.numel() and float(tensor.abs().max()) > 1.0 + 1e-6:
        worst = tensor.flatten()[tensor.abs().argmax()]
        raise PwmGymError(f"actions hold {float(worst):.8g}; expected values in [-1, 1]")
    return tensor


def _array(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        return np.asarray(actions)
    except ValueError as error:
        raise PwmGymError(f"actions are ragged; expected an array of shape {shape}") from error


def check_options(options: Any, known: Sequence[str]) -> dict[str, Any]:
    """The options of a reset, a copy.

    Raises:
        PwmGymError: no mapping.
        UnknownNameError: an option that there is not.
    """
    if options is not None and not isinstance(options, Mapping):
        raise PwmGymError(f"options is a {type(options).__name__}; expected a dict")
    for key in options or {}:
        if key not in known:
            raise unknown_name("reset option", key, known)
    return dict(options or {})


def seeds_of(seed: Any, count: int) -> list[int | None]:
    """Seeds of ``count`` environments: one each, or ``seed`` + i for the environment i; None leaves one unseeded.

    Raises:
        PwmGymError: another number of seeds, or something that is no seed.
    """
    if not isinstance(seed, Sequence | np.ndarray) or isinstance(seed, str):
        first = check_seed(seed)
        return [first + i for i in range(count)]
    if len(seed) != count:
        raise PwmGymError(f"{len(seed)} seeds for {count} environments")
    return [None if value is None else check_seed(value) for value in seed]


def check_render_mode(mode: str | None, known: Sequence[str]) -> str | None:
    """``mode``, one of ``known`` or None.

    Raises:
        UnknownNameError: listing the known ones.
    """
    if mode not in (None, *known):
        raise unknown_name("render mode", str(mode), known)
    return mode


def last_action(scene: Scene, control: Control) -> np.ndarray:
    """The action (A,) that led to a scene; the control's rest where it does not say.

    Raises:
        SceneError: it is no action of this size.
    """
    if scene.last_action is None:
        return np.array(control.rest(), np.float32)
    try:
        return check_actions(scene.last_action, (control.size,)).numpy()
    except PwmGymError as error:
        raise SceneError(f"scene.last_action: {error}") from error


@dataclass(frozen=True)
class Judgement:
    """What a cost and the rules say of states (B,)."""

    reward: Tensor
    """Minus the cost (B,)."""
    terms: dict[str, Tensor]
    """The cost's weighted terms, each (B,)."""
    success: Tensor
    """Bool (B,)."""
    grasped: Tensor
    """Bool (B,)."""
    stage: Tensor | None
    """Stage (B,) of the task, where it is a sequence of stages."""


class Rules:
    """Reward, success and grasp of a task, by registered functions.

    Args:
        task: gives the defaults.
        cost: a registered name or a callable; changing it leaves the success rule alone.
        grasp: a registered grasp rule.
    """

    def __init__(self, task: Task, cost: str | Callable[..., Tensor] | None, grasp: str | None) -> None:
        self._task, self._grasp_name = task, grasp
        self.cost: Cost = get_cost(task.cost if cost is None else cost)
        self.grasp = get_grasp(task.grasp if grasp is None else grasp)
        self.success = get_success(task.success)
        planned = get_cost(task.plan_cost)
        staged = [c for c in (self.cost, planned) if isinstance(c, StagedCost)]
        self.stages: StagedCost | None = staged[0] if staged else None

    def with_cost(self, cost: str | Callable[..., Tensor] | None) -> Rules:
        """The same rules with another cost."""
        return Rules(self._task, cost, self._grasp_name)

    @property
    def stage_names(self) -> tuple[str, ...]:
        """Names of the stages of the cost, or else of the task's planning cost; empty where there are none."""
        return () if self.stages is None else self.stages.stage_names

    @torch.no_grad()
    def judge(self, state: State, action: Tensor, goal: Tensor, stage: Tensor | None = None) -> Judgement:
        """Judge states (B,) that actions (B, A) led to, for goals (B, G).

        ``stage`` (B,) is what a sequence of stages had come to before; None is its first one.
        """
        points, info = cost_info(state, action, goal, self.grasp)
        if self.stages is not None:
            before = self.stages.begin(len(action), action.device) if stage is None else stage
            stage = self.stages.advance(before, points, info)
            info["stage"] = stage.clone()
        grasped = info["grasped"].clone()
        success = self.success(points, info)  # before a cost of the user's own, which may write into what it reads
        terms = self.cost.evaluate(points, info)
        reward = -torch.stack(list(terms.values())).sum(0)
        return Judgement(reward, terms, success, grasped, stage)


def with_rows(state: State, index: Tensor, fresh: State) -> State:
    """A state (B,) whose rows at ``index`` are those of ``fresh``.

    Raises:
        SceneError: one of them knows what the other does not, such as the robot's joints.
    """
    if isinstance(state, RigidState) and isinstance(fresh, RigidState):  # what a model's steps drop is not missed
        joints = None if state.joints is None else fresh.joints
        fresh = replace(fresh, joints=joints, error=None if state.error is None else fresh.error)
    old, new = ([x.shape[1:] for x in s.tensors] for s in (state, fresh))
    if old != new:
        raise SceneError(
            f"the new scenes' state has tensors of shapes {[*map(tuple, new)]}, that of the environments which go on "
            f"{[*map(tuple, old)]}; expected the same (are joints known in some scenes only?)"
        )
    rows = iter(fresh.tensors)
    return state.map(lambda x: x.index_copy(0, index, next(rows)))
