"""The learned world model as a native Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from torch import Tensor

from pwm_gym.dynamics.bank import SceneBank
from pwm_gym.dynamics.checkpoint import load_checkpoint, resolve, use_device
from pwm_gym.dynamics.protocols import expected_error
from pwm_gym.envs.common import (
    OBSERVATIONS,
    Judgement,
    Rules,
    action_space,
    bounded,
    check_actions,
    check_mask,
    check_options,
    check_render_mode,
    first_entities,
    last_action,
    outside,
    seeds_of,
    with_rows,
)
from pwm_gym.envs.infos import vector_infos
from pwm_gym.envs.rendering import SceneRenderer, picture_camera
from pwm_gym.errors import PwmGymError, SceneError, check_whole, look_up
from pwm_gym.scene import Entity, RigidState, Scene, State, batch_state
from pwm_gym.scene.se3 import pose7_from_matrix
from pwm_gym.tasks import get_task

__all__ = ["ModelVectorEnv"]

_OPTIONS = ("scene", "reset_mask")


class ModelVectorEnv(EzPickle, gym.vector.VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """``num_envs`` scenes in one tensor batch; a step is one forward pass of the world model.

    Observations, rewards and infos are those of :class:`pwm_gym.envs.ModelEnv` with a leading ``num_envs``.

    Args:
        task: registered task.
        num_envs: B.
        checkpoint: a folder, the name of a shipped checkpoint, or "default" for the task's own.
        cost: a registered cost or a callable ``(points, info) -> (B,)``; None takes the task's.
        grasp: a registered grasp rule; None takes the task's.
        device: PyTorch device of the model.
        points: points of a scene in all; None takes the task's count.
        max_episode_steps: truncates longer episodes; None never does.
        render_mode: None or "rgb_array".
        autoreset_mode: Gymnasium's ``AutoresetMode`` (or its value); NEXT_STEP by default.
        tensors: whether observations and rewards are torch tensors on ``device`` instead of NumPy arrays.
        observation: "points" (the Dict of clouds and goal) or "poses" (as :class:`pwm_gym.wrappers.EntityPoses`;
            no cloud is formed that only an observation would show).
        scenes: what episodes start from; None takes the checkpoint's.
        width: of pictures, pixels.
        height: of pictures, pixels.

    Raises:
        UnknownNameError, CheckpointError, PwmGymError: arguments that do not fit, each naming the value.

    Version history:
        v0: initial release.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's own type)
        "render_modes": ["rgb_array"],
        "render_fps": 20,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        task: str = "PickCube",
        num_envs: int = 1,
        checkpoint: str = "default",
        cost: str | Callable[..., Tensor] | None = None,
        grasp: str | None = None,
        device: str = "cpu",
        points: int | None = None,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        tensors: bool = False,
        observation: str = "points",
        scenes: SceneBank | None = None,
        width: int = 320,
        height: int = 320,
    ) -> None:
        EzPickle.__init__(
            self,
            task,
            num_envs,
            checkpoint,
            cost,
            grasp,
            device,
            points,
            max_episode_steps,
            render_mode,
            autoreset_mode,
            tensors,
            observation,
            scenes,
            width,
            height,
        )
        check_whole("num_envs", num_envs, 1)
        if max_episode_steps is not None:
            check_whole("max_episode_steps", max_episode_steps, 1)
        self.task, self.num_envs = get_task(task), num_envs
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        self.device, self.max_episode_steps, self._tensors = use_device(device), max_episode_steps, tensors
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.checkpoint = load_checkpoint(resolve(checkpoint, task), device)
        self.checkpoint.check_robot(self.task.layout, self.task.control)
        self.checkpoint.check_joints(self.task.layout)
        self.model = self.checkpoint.model
        self.layout = self.task.layout if points is None else self.task.layout.resize(points)
        self.rules = Rules(self.task, cost, grasp)
        self.single_action_space = action_space(self.task.action_size)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observe_as(observation)
        self._bank = scenes
        self._generators = [torch.Generator() for _ in range(num_envs)]
        for generator in self._generators:
            generator.seed()
        self._state: State | None = None
        self._goal = torch.zeros(num_envs, self.task.goal_size, device=self.device)
        self._action = torch.zeros(num_envs, self.task.action_size, device=self.device)
        self._assets: list[tuple[str, ...]] = [()] * num_envs
        self._elapsed = np.zeros(num_envs, np.int64)
        self._done = np.zeros(num_envs, bool)
        self._held = np.zeros(num_envs, bool)
        self._stage: Tensor | None = None  # (B,), where the task is a sequence of stages
        self._picture_camera = picture_camera(width, height)
        self._renderer: SceneRenderer | None = None

    def observe_as(self, observation: str) -> None:
        """Show "points" or "poses" from the next observation on; the spaces change with it.

        Raises:
            UnknownNameError: neither of the two.
        """
        self._shown = look_up("observation", observation, OBSERVATIONS)
        self.single_observation_space = self._shown.space(self.layout, self.task.goal_size)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    @property
    def entities(self) -> tuple[Entity, ...]:
        """The task's entities and their slices of the points."""
        return self.layout.entities

    @property
    def state(self) -> State:
        """The present state (B,), of all entities of the scenes that it started from."""
        if self._state is None:
            raise PwmGymError("the environment has no state yet; call reset() first")
        return self._state

    @property
    def observed_state(self) -> State:
        """The present state (B,) of the task's entities, which observations are of."""
        return first_entities(self.state, self.layout)

    @property
    def goal(self) -> Tensor:
        """Goals (B, G)."""
        return self._goal

    @property
    def done(self) -> np.ndarray:
        """Whose episodes have ended (num_envs,) bool: with NEXT_STEP, the next step restarts them."""
        return self._done.copy()

    @property
    def held(self) -> np.ndarray:
        """Which stand still (num_envs,) bool; see :meth:`hold`."""
        return self._held.copy()

    def scene(self, index: int = 0) -> Scene:
        """The present scene of one environment, velocities included: what ``options["scene"]`` takes."""
        frames = self.state.history()[index].double().cpu()  # (3, E, 4, 4)
        joints = self.state.joints if isinstance(self.state, RigidState) else None
        return Scene(
            task=self.task.name,
            layout=self.state.layout,
            clouds=self.state.clouds[index].cpu().numpy().copy(),
            poses=pose7_from_matrix(frames).numpy(),
            goal=self._goal[index].cpu().numpy().copy(),
            joints=None if joints is None else joints[index].cpu().numpy().copy(),
            last_action=self._action[index].cpu().numpy().copy(),
            assets=self._assets[index],
        )

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start episodes from the checkpoint's bank, or from ``options["scene"]`` (one scene, or one each).

        Args:
            seed: an integer means seed + i for environment i; a list gives each its own.
            options: "scene", and with autoreset disabled "reset_mask" (num_envs,) bool. With autoreset disabled a
                scene may have further free entities after the task's; all environments then have them.
        """
        options = check_options(options, _OPTIONS)
        mask = self._reset_mask(options.get("reset_mask"))
        self._seed(seed, mask)
        self._held[mask] = False
        self._restart(mask, self._scenes(options.get("scene"), mask))
        judgement = self._judge()
        return self._observation(), self._info(judgement, [""] * self.num_envs)

    def _seed(self, seed: int | Sequence[int | None] | None, mask: np.ndarray) -> None:
        """Seed the generators of the environments that ``mask`` restarts."""
        if seed is None:
            return
        seeds = seeds_of(seed, self.num_envs)
        for i in np.flatnonzero(mask):
            if (value := seeds[i]) is not None:
                self._generators[i].manual_seed(value)

    def _reset_mask(self, mask: Any) -> np.ndarray:
        if mask is None:
            return np.ones(self.num_envs, bool)
        mask = check_mask("reset_mask", mask, self.num_envs)
        if not mask.any():
            raise PwmGymError("reset_mask selects no environment")
        if self._state is None and not mask.all():
            raise PwmGymError("the first reset must reset every environment; reset_mask leaves some out")
        return mask

    def _scenes(self, scene: Scene | Sequence[Scene] | None, mask: np.ndarray) -> list[Scene]:
        """One scene for each environment of ``mask``."""
        chosen = np.flatnonzero(mask)
        if scene is None:
            bank = self.checkpoint.bank(self.task.name) if self._bank is None else self._bank
            draws = [int(torch.randint(len(bank), (), generator=self._generators[i])) for i in chosen]
            return [bank.scene(k).coarsen(self.layout) for k in draws]
        scenes: list[Any] = list(scene) if isinstance(scene, list | tuple) else [scene] * len(chosen)
        if len(scenes) != len(chosen):
            raise PwmGymError(f"{len(scenes)} scenes for {len(chosen)} environments to reset")
        for item in scenes:
            if not isinstance(item, Scene):
                raise PwmGymError(f"scene is a {type(item).__name__}; expected pwm_gym.Scene")
        return [self._fitted(s) for s in scenes]

    def _fitted(self, scene: Scene) -> Scene:
        """A user's scene with this environment's points; further entities keep theirs."""
        further = scene.layout.entities[len(self.layout) :]
        scene.validate(self.task.name, self.layout, self.task.goal_size, extra=True)
        if further and self.autoreset_mode is not AutoresetMode.DISABLED:
            names = ", ".join(e.name for e in further)
            raise SceneError(f"the scene has {names} besides the task's entities; that needs autoreset_mode 'Disabled'")
        return scene.coarsen(self.layout.plus(further))

    def _restart(self, mask: np.ndarray, scenes: list[Scene]) -> None:
        """Put ``scenes`` where ``mask`` is set."""
        fresh, actions = self._prepared(scenes, mask)
        goals = torch.as_tensor(np.stack([s.goal for s in scenes]), dtype=torch.float32, device=self.device)
        index = torch.as_tensor(np.flatnonzero(mask), device=self.device)
        self._state = fresh if self._state is None or mask.all() else with_rows(self._state, index, fresh)
        for i, scene in zip(np.flatnonzero(mask), scenes, strict=True):
            self._assets[i] = scene.assets
        self._goal = self._goal.index_copy(0, index, goals)
        self._action = self._action.index_copy(0, index, actions)
        if self._stage is not None:
            self._stage = self._stage.index_fill(0, index, 0)
        self._elapsed[mask] = 0
        self._done[mask] = False

    def _prepared(self, scenes: list[Scene], mask: np.ndarray) -> tuple[State, Tensor]:
        """State (n,) of the scenes for where ``mask`` is set, and the actions (n, A) that led to them."""
        actions = np.stack([last_action(s, self.task.control) for s in scenes])
        self._check_layouts(scenes, mask)
        return self.model.prepare(batch_state(scenes, self.device)), torch.as_tensor(actions, device=self.device)

    def _check_layouts(self, scenes: list[Scene], mask: np.ndarray) -> None:
        """One batch has one layout: the new scenes', and that of the environments which go on."""
        kept = None if self._state is None or mask.all() else self._state.layout
        expected = kept or scenes[0].layout
        for scene in scenes:
            if scene.layout != expected:
                raise SceneError(
                    f"a scene's entities are {scene.layout.names}, of {scene.layout.points} points; expected those of "
                    f"the other environments, {expected.names}, of {expected.points}"
                )

    @torch.no_grad()
    def step(self, actions: np.ndarray | Tensor) -> tuple[dict[str, Any], Any, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step of every environment under actions (num_envs, A) in [-1, 1]."""
        action = check_actions(actions, self.action_space.shape or ()).to(self.device)
        if self.autoreset_mode is AutoresetMode.DISABLED and (self._done & ~self._held).any():
            raise PwmGymError("some environments are done; reset them with options={'reset_mask': ...} first")
        restarted = self._done & ~self._held
        self._advance(action)
        escaped = outside(self.state)
        if escaped.any():
            self._state = bounded(self.state)
        if restarted.any():
            self._restart(restarted, self._scenes(None, restarted))
        judgement = self._judge()
        return self._finish(judgement, escaped.cpu().numpy() & ~restarted, restarted)

    def _advance(self, action: Tensor) -> None:
        """Move all that is not held."""
        before, self._state = self.state, self.model.step(self.state, action)
        if self._held.any():
            held = torch.as_tensor(np.flatnonzero(self._held), device=self.device)
            self._state = with_rows(self._state, held, before[held])
            action = action.index_copy(0, held, self._action[held])
        self._action = action
        self._elapsed[~self._held] += 1

    def hold(self, mask: np.ndarray) -> None:
        """Let the environments of ``mask`` (num_envs,) bool stand still from the next step on, and only those.

        They neither move nor restart, their reward is 0, and they are not told to end again. A reset lets go of what it
        resets.
        """
        self._held = check_mask("mask", mask, self.num_envs).copy()

    def set_cost(self, cost: str | Callable[..., Tensor] | None) -> None:
        """Reward by another cost from now on, a registered or a callable one; stages begin anew."""
        self.rules, self._stage = self.rules.with_cost(cost), None

    def synchronise(self, scene: Scene | Sequence[Scene]) -> None:
        """Go on from other scenes, one for all or one each; goals, stages and the time that has passed stay."""
        every = np.ones(self.num_envs, bool)
        self._state, self._action = self._prepared(self._scenes(scene, every), every)

    def end(self, mask: np.ndarray) -> None:
        """End the episodes of ``mask`` (num_envs,) bool.

        With autoreset "NextStep" the next step restarts them; with "Disabled" they have to be reset before it.

        Raises:
            PwmGymError: no such mask, or autoreset "SameStep", which restarts within the step that ends an episode.
        """
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            raise PwmGymError("autoreset_mode is 'SameStep'; ending episodes needs 'NextStep' or 'Disabled'")
        self._done |= check_mask("mask", mask, self.num_envs)

    def resume(self) -> None:
        """Go on after an episode's end, as Gymnasium's single environments may."""
        self._done[:] = False

    def _judge(self) -> Judgement:
        """Judge the present state; what is held keeps its stage."""
        judgement = self.rules.judge(self.state, self._action, self._goal, self._stage)
        stage, before = judgement.stage, self._stage
        if stage is not None and before is not None and self._held.any():
            stage = torch.where(torch.as_tensor(self._held, device=self.device), before, stage)
            judgement = replace(judgement, stage=stage)
        self._stage = stage
        return judgement

    def _finish(self, judgement: Judgement, escaped: np.ndarray, restarted: np.ndarray) -> tuple[Any, ...]:
        """Ends, infos and, with SAME_STEP, the restarts of the step just made."""
        late = np.zeros(self.num_envs, bool)
        if self.max_episode_steps is not None:
            late = (self._elapsed >= self.max_episode_steps) & ~restarted
        resting = restarted | self._held
        terminated = judgement.success.cpu().numpy() & ~resting & ~escaped
        truncated = (escaped | late) & ~resting
        reasons = np.where(escaped, "left the bounds", np.where(late, "time limit", "")).tolist()
        reward = judgement.reward.masked_fill(torch.as_tensor(resting, device=self.device), 0.0)
        observation, info = self._observation(), self._info(judgement, reasons)
        self._done = terminated | truncated | (self._done & self._held)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._done.any():
            observation, info = self._restart_now(observation, info)
        return observation, self._out(reward), terminated, truncated, info

    def _restart_now(self, observation: dict[str, Any], info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """SAME_STEP: the finished environments' first observations, their last ones in ``final_obs``."""
        done = self._done.copy()
        final = {"final_obs": observation, "_final_obs": done, "final_info": info, "_final_info": done}
        self._restart(done, self._scenes(None, done))
        judgement = self._judge()
        fresh = self._info(judgement, [""] * self.num_envs)
        return self._observation(), {**fresh, **final}

    def _observation(self) -> Any:
        """Observations (num_envs, ...) of the present state."""
        return self._out(self._shown.observe(self.observed_state, self._goal))

    def _out(self, value: Any) -> Any:
        """Arrays (or tensors) for the caller, who alone holds ``value``."""
        if isinstance(value, dict):
            return {k: self._out(v) for k, v in value.items()}
        return value if self._tensors else value.cpu().numpy()

    def _info(self, judgement: Judgement, reasons: list[str]) -> dict[str, Any]:
        """Gymnasium's vector infos of the present state."""
        error = expected_error(self.state)
        errors = None if error is None else dict(zip(self.state.layout.names, error.unbind(-1), strict=True))
        return vector_infos(judgement, reasons, self.rules.stage_names, errors)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture (H, W, 3) uint8 of each environment, with ``render_mode="rgb_array"``."""
        if self.render_mode is None:
            return None
        if self._renderer is None or self._renderer.layout != self.state.layout:
            self._renderer = SceneRenderer(self.state.layout, "predicted", self._picture_camera)
        points, goals = self.state.points().cpu().numpy(), self._goal.cpu().numpy()
        return tuple(self._renderer(p, g) for p, g in zip(points, goals, strict=True))

    def close_extras(self, **kwargs: Any) -> None:
        """Nothing to free."""
