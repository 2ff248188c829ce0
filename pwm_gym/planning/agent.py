"""A planner with a world model and a cost: scenes in, actions out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pwm_gym.costs import Cost, StagedCost, cost_info, get_cost, get_grasp
from pwm_gym.costs.registry import Function
from pwm_gym.dynamics.model import WorldModel
from pwm_gym.dynamics.protocols import MeetsScenes
from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.planning.objective import RolloutObjective
from pwm_gym.planning.posture import PosedModel, Posture
from pwm_gym.planning.registry import build_planner, get_planner_config
from pwm_gym.planning.sampling import Planner, SamplingConfig
from pwm_gym.scene import Scene, State, batch_state
from pwm_gym.tasks import get_task

__all__ = ["Agent"]


class Agent:
    """Plans from where it last looked, or from where its actions have led in the model since.

    Args:
        model: world model to plan in.
        task: registered task.
        config: settings of the planner; None takes the task's planner's.
        cost: a registered cost or a callable; None takes the task's planning cost.
        seed: of the planner's noise.
        device: of the model.
        penalties: further terms of the cost, name -> weight and function (:mod:`pwm_gym.planning.constraints`).
        caution: cost of a metre of expected error at a step, for models that tell it.
        guide: a policy, actions (B, A) of a state (B,) for goals (B, G); what it would do in the model is where a plan
            starts from, if that is cheaper than the last plan.
    """

    def __init__(
        self,
        model: WorldModel,
        task: str = "PickCube",
        config: SamplingConfig | None = None,
        cost: str | Callable[..., Tensor] | None = None,
        seed: int = 0,
        device: str = "cpu",
        penalties: Mapping[str, tuple[float, Function]] | None = None,
        caution: float = 0.0,
        guide: Callable[[State, Tensor], Tensor] | None = None,
    ) -> None:
        self.task, self.device, self.model, self.guide = get_task(task), device, model, guide
        config = config or get_planner_config(self.task.planner)
        self.cost = get_cost(self.task.plan_cost if cost is None else cost).plus(penalties or {})
        self._posture = Posture(self.task.control, self.task.postures) if config.posture else None
        fixed = () if self._posture is None else self._posture.fixed
        self.planner: Planner = build_planner(config, self.task.control, device, fixed)
        self._planned_in = model if self._posture is None else PosedModel(model, self._posture)
        self.objective = RolloutObjective(self._planned_in, self.cost, get_grasp(self.task.grasp), caution=caution)
        self._generator = torch.Generator(device).manual_seed(seed)
        self._state: State | None = None
        self._seen_stage: Tensor | None = None  # (B,) of a staged cost, where it last looked
        self._last_stage: Tensor | None = None  # (B,) in the state before the present one
        self._stage: Tensor | None = None  # (B,) in the present state, where it has been asked for
        self._goal = torch.empty(0)
        self._action: Tensor | None = None  # (B, A), that led to the state, where it is known
        self._one = True  # whether it looked at one scene, not at a sequence of them

    def reset(self, seed: int) -> None:
        """Forget the last plan and the last scene, and reseed the noise."""
        self.planner.reset()
        self._generator.manual_seed(seed)
        self._state = self._action = None
        self._stage = self._last_stage = self._seen_stage = None

    def look(self, scene: Scene | Sequence[Scene]) -> None:
        """Go on from a scene, or from several at once, which may have entities besides the task's.

        Raises:
            SceneError: a scene of another task, or one whose arrays do not fit or are not finite.
        """
        self._one = isinstance(scene, Scene)
        scenes = [scene] if isinstance(scene, Scene) else list(scene)
        for item in scenes:
            self._check(item)
        if isinstance(self.model, MeetsScenes):
            self.model.meet(scenes)
        self._state = self.model.prepare(batch_state(scenes, self.device))
        goals = np.stack([s.goal for s in scenes])
        self._goal = torch.as_tensor(goals, dtype=torch.float32, device=self.device)
        actions = [s.last_action for s in scenes if s.last_action is not None]
        self._action = None
        if len(actions) == len(scenes):
            self._action = torch.as_tensor(np.stack(actions), dtype=torch.float32, device=self.device)
        self._last_stage, self._stage = self._seen_stage, None
        self._seen_stage = self._present_stage()

    def _present_stage(self) -> Tensor | None:
        """Stage (B,) of a staged cost in the present state; None of other costs."""
        if self._stage is None and isinstance(self.cost, StagedCost):
            size, before = len(self._goal), self._last_stage
            if before is None or len(before) != size:
                before = self.cost.begin(size, self.device)
            action = self._goal.new_zeros(size, self.task.action_size) if self._action is None else self._action
            seen = cost_info(self._present(), action, self._goal, self.objective.grasp)
            self._stage = self.cost.advance(before, *seen)
        return self._stage

    @property
    def stage(self) -> tuple[str, ...]:
        """Name of the stage of each scene, where the cost is a sequence of stages; empty elsewhere."""
        stage = None if self._state is None else self._present_stage()
        if not isinstance(self.cost, StagedCost) or stage is None:
            return ()
        return tuple(self.cost.stage_names[int(k)] for k in stage)

    def _check(self, scene: Scene) -> None:
        wanted, size = self.task.layout.names, self.task.action_size
        if scene.layout.names[: len(wanted)] != wanted:
            raise SceneError(f"the scene's entities are {scene.layout.names}; expected them to begin with {wanted}")
        scene.validate(self.task.name, scene.layout, self.task.goal_size)  # of any number of points
        action = scene.last_action
        if action is not None and (np.shape(action) != (size,) or not np.isfinite(action).all()):
            raise SceneError(f"scene.last_action is {action}; expected {size} finite values")

    def plan(self, scene: Scene | Sequence[Scene] | None = None) -> np.ndarray:
        """Planned actions (H, A), or (B, H, A) of several scenes.

        Args:
            scene: to look at first; None plans from the present state.

        Raises:
            PwmGymError: there is no state yet.
        """
        if scene is not None:
            self.look(scene)
        return self._told(self._actions())

    def _actions(self, steps: int | None = None) -> Tensor:
        """The first ``steps`` actions (B, steps, A) from the present state on; None tells all that are planned."""
        objective = self.objective.begin(self._present(), self._goal, self._present_stage())
        proposal = self._follow(self.guide) if self.guide is not None else None
        plans = self.planner.plan(objective, self._generator, len(self._goal), self._action, proposal)
        return self._posed(plans[:, :steps])

    @torch.no_grad()
    def _posed(self, plans: Tensor) -> Tensor:
        """Action sequences (B, H, A) as hands execute them that keep their posture."""
        if self._posture is None:
            return plans
        state, kept = self._present(), list[Tensor]()
        for k, action in enumerate(plans.unbind(1)):
            state = state if k == 0 else self.model.step(state, kept[-1])
            kept.append(self._posture(state, action))
        return torch.stack(kept, 1)

    def _told(self, actions: Tensor) -> np.ndarray:
        """Actions (B, ...) of all scenes, or those (...) of the one that it looked at."""
        told = actions.cpu().numpy()
        return told[0].copy() if self._one else told.copy()  # the planner keeps its own

    @torch.no_grad()
    def _follow(self, guide: Callable[[State, Tensor], Tensor]) -> Tensor:
        """Actions (B, H, A) of a policy in the model, from the present state on."""
        state, actions = self._present(), []
        for _ in range(self.planner.horizon):
            actions.append(guide(state, self._goal).to(self.device))
            state = self._planned_in.step(state, actions[-1])
        return torch.stack(actions, 1)

    def act(self, scene: Scene | Sequence[Scene] | None = None) -> np.ndarray:
        """First action (A,) of :meth:`plan`, or first actions (B, A)."""
        if scene is not None:
            self.look(scene)
        return self._told(self._actions(1))[..., 0, :]

    @torch.no_grad()
    def advance(self, action: np.ndarray) -> State:
        """Take the model's prediction (B,) of an action (A,), or of actions (B, A), for the present state."""
        command = torch.as_tensor(action, dtype=torch.float32, device=self.device)
        actions = command[None] if self._one else command
        self._last_stage, self._stage = self._present_stage(), None
        self._state = self.model.step(self._present(), actions)
        self._action = actions
        return self._state

    @torch.no_grad()
    def terms(self, states: State, actions: np.ndarray) -> dict[str, np.ndarray]:
        """The planning cost's weighted terms, each (T,), in states (T,) after actions (T, A), from the first on."""
        points, info = self._seen(states, actions, self.cost, self.objective.grasp)
        return {name: value.cpu().numpy() for name, value in self.cost.evaluate(points, info).items()}

    @torch.no_grad()
    def rewards(
        self, states: State, actions: np.ndarray, cost: Cost | None = None, grasp: Function | None = None
    ) -> np.ndarray:
        """Rewards (T,) in states (T,) after actions (T, A).

        Args:
            states: one after the other, the first of an episode first.
            actions: that led there.
            cost: cost whose negative they are; None takes the task's.
            grasp: grasp rule that the cost is told of; None takes the task's.
        """
        chosen = cost or get_cost(self.task.cost)
        points, info = self._seen(states, actions, chosen, grasp or self.objective.grasp)
        return -chosen(points, info).cpu().numpy()

    def _seen(
        self, states: State, actions: np.ndarray, cost: Cost, grasp: Function
    ) -> tuple[Mapping[str, Tensor], dict[str, Any]]:
        """What ``cost`` reads of states (T,) after actions (T, A), for the first goal."""
        command = torch.as_tensor(actions, device=self.device)
        points, info = cost_info(states, command, self._goal[:1].expand(len(command), -1), grasp)
        if isinstance(cost, StagedCost):
            info["stage"] = cost.along(cost.begin(1, self.device), points, info, len(command)).squeeze(0)
        return points, info

    def describe(self) -> dict[str, Any]:
        """What it plans with: model, planner and cost by name, and the cost's stages where it has some."""
        cost = self.cost
        stages = {"stages": list(cost.stage_names), "stage_price": cost.price} if isinstance(cost, StagedCost) else {}
        return {
            "model": type(self.model).__name__,
            "planner": type(self.planner).__name__,
            "cost": self.cost.name,
            "caution": self.objective.caution,
            **stages,
        }

    def _present(self) -> State:
        if self._state is None:
            raise PwmGymError("the agent has no state yet; give plan() a scene, or call look() first")
        return self._state
