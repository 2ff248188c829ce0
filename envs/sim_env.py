"""The simulator as an environment with the model's spaces: its twin."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.utils import EzPickle
from torch import Tensor

from pwm_gym.envs.build import build_observation_model
from pwm_gym.envs.common import (
    Judgement,
    Rules,
    action_space,
    check_actions,
    check_options,
    check_render_mode,
    first_entities,
    last_action,
    observation_space,
    observe,
)
from pwm_gym.envs.observation_models import OBSERVATIONS, Bodies, CameraConfig
from pwm_gym.envs.rendering import SceneRenderer, Window, modes_here, picture_camera
from pwm_gym.errors import PwmGymError, SceneError, check_seed, unknown_name
from pwm_gym.scene import Entity, Layout, RigidState, Scene, State, batch_state, sample_surface
from pwm_gym.seeds import RANGES
from pwm_gym.sim import SimOutcome, Simulator, StartsUnderway
from pwm_gym.tasks import Task, get_task

if TYPE_CHECKING:
    import trimesh

__all__ = ["SimEnv"]


class AssetClouds:
    """Canonical clouds of the assets that a task's episodes have had, each sampled once.

    Args:
        task: gives the full counts of points and the seed of the clouds.
        layout: the same entities with the points that are wanted.
    """

    def __init__(self, task: Task, layout: Layout) -> None:
        self._task, self._layout = task, layout
        self._sampled: dict[tuple[int, str], np.ndarray] = {}

    def __call__(self, assets: tuple[str, ...], meshes: Callable[[], Mapping[str, trimesh.Trimesh]]) -> np.ndarray:
        """Canonical points (N, 3) of an episode's assets (E,), whose surfaces ``meshes`` makes.

        Raises:
            SceneError: another number of assets than entities, or an entity without a surface.
        """
        names = self._layout.names
        if len(assets) != len(names):
            raise SceneError(f"the simulator names {len(assets)} assets; expected one for each of {', '.join(names)}")
        for i, (entity, asset) in enumerate(zip(self._task.layout, assets, strict=True)):
            if (i, asset) not in self._sampled:
                if entity.name not in meshes():
                    raise SceneError(f"no mesh for {entity.name}; got {', '.join(meshes()) or 'none'}")
                seed = self._task.cloud_seed + i
                self._sampled[i, asset] = sample_surface(meshes()[entity.name], entity.points, seed)
        parts = [
            self._sampled[i, asset][: e.points] for i, (e, asset) in enumerate(zip(self._layout, assets, strict=True))
        ]
        return np.concatenate(parts)


class SimEnv(EzPickle, gym.Env[dict[str, np.ndarray], np.ndarray]):
    """
    ## Description
    The simulator-backed twin of a model environment: the same task, spaces and meaning of actions, with
    clouds sampled on the simulator's own meshes ("complete" observation), with what one camera sees of
    them ("partial"), or with what is made of its depth: objects completed and tracked, the robot from its
    joint angles ("completed").

    ## Action space
    As in :class:`pwm_gym.envs.ModelEnv`.

    ## Observation space
    As in :class:`pwm_gym.envs.ModelEnv`.

    ## Reward
    Minus the registered cost on the true clouds; the simulator's own is in `info["simulator_reward"]`.

    ## Starting state
    The simulator's initial distribution, of several the one called `starts`; `reset(seed=s)` is the
    simulator's episode of seed s. A scene with joint positions (`env.unwrapped.scene(truth=True)` of this
    environment) starts there with `reset(options={"scene": scene})`, also with further free entities
    (clutter) after the task's own, which observations leave out; `env.unwrapped.scene()` has them.

    ## Episode end
    The simulator's own success terminates; `gym.make` adds the time limit.

    ## Info
    `success` (the simulator's), `grasped`, `cost_terms`, `reason`, `simulator_reward`, `simulator_grasped`, `holding`
    (names of the arms that stayed where they were, because what they were asked for is out of their reach; only of
    robots whose controllers tell); of tasks that are sequences of stages `stage`, the present one's name;
    with the "completed" observation `completion_error` (expected Chamfer distance of each object's
    completed cloud, metres) and `perception_seconds`.

    ## Arguments
    * `task`: registered task. * `cost`: a registered cost or a callable. * `grasp`: a registered grasp rule.
    * `observation`: "complete", "completed" or "partial". * `camera`: viewpoint, sensor and completer of the
    last two: a `pwm_gym.envs.CameraConfig`, its fields as a dict, or a viewpoint's name.
    * `points`: points of a scene in all. * `objects`: what episodes draw their objects from, where they differ: one of
    the task's `object_sets`, an object's name, or names. * `starts`: where episodes start, of tasks that have several
    `starts` (a benchmark's own evaluation tasks, say). * `render_mode`: None, "rgb_array" or "human" (a
    window that shows every step; extra `video`). * `width`, `height`: of its pictures, pixels.

    ## Version history
    * v0: initial release.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        task: str = "PickCube",
        cost: str | Callable[..., Tensor] | None = None,
        grasp: str | None = None,
        observation: str = "complete",
        points: int | None = None,
        render_mode: str | None = None,
        camera: CameraConfig | Mapping[str, Any] | str | None = None,
        objects: str | Sequence[str] | None = None,
        width: int = 320,
        height: int = 320,
        starts: str | None = None,
    ) -> None:
        EzPickle.__init__(
            self, task, cost, grasp, observation, points, render_mode, camera, objects, width, height, starts
        )
        if observation not in OBSERVATIONS:  # before a simulator is made
            raise unknown_name("observation", observation, OBSERVATIONS)
        self.task, self.render_mode = get_task(task), render_mode
        self.metadata = {**self.metadata, "render_modes": modes_here(self.metadata["render_modes"])}
        self._window = Window(self.metadata["render_fps"]) if render_mode == "human" else None
        check_render_mode(render_mode, self.metadata["render_modes"])
        self._picture_camera = picture_camera(width, height)
        self.layout = self.task.layout if points is None else self.task.layout.resize(points)
        self.rules = Rules(self.task, cost, grasp)
        self.action_space = action_space(self.task.action_size)
        self.observation_space = observation_space(self.layout, self.task.goal_size)
        self._observation = build_observation_model(observation, self.task, CameraConfig.of(camera))
        self.simulator: Simulator = self.task.make_simulator(objects, starts)
        self._clouds = AssetClouds(self.task, self.layout)
        self._scene: Scene | None = None  # that the episode began with
        self._now: Scene | None = None
        self._shown: Scene | None = None
        self._poses: deque[np.ndarray] = deque(maxlen=3)  # newest first
        self._action = np.array(self.task.control.rest(), np.float32)
        self._stage: Tensor | None = None  # (1,), where the task is a sequence of stages
        self._renderer: SceneRenderer | None = None
        self._closed = False

    def set_cost(self, cost: str | Callable[..., Tensor] | None) -> None:
        """Reward by another cost from now on, a registered or a callable one; stages begin anew."""
        self.rules, self._stage = self.rules.with_cost(cost), None

    def set_observation(self, observation: str, camera: CameraConfig | Mapping[str, Any] | str | None = None) -> None:
        """Observe otherwise from the next reset on; arguments and errors as of the constructor."""
        self._observation = build_observation_model(observation, self.task, CameraConfig.of(camera))

    @property
    def entities(self) -> tuple[Entity, ...]:
        """Entities and their slices of the points."""
        return self.layout.entities

    @property
    def state(self) -> RigidState:
        """The present state (1,), the true one."""
        return batch_state([self.scene(truth=True)])

    @property
    def observed_state(self) -> State:
        """The state (1,) of the task's entities that observations are of."""
        return first_entities(batch_state([self.scene()]), self.layout)

    @property
    def goal(self) -> Tensor:
        """Goal (1, G)."""
        return torch.as_tensor(self.scene(truth=True).goal)[None]

    def scene(self, truth: bool = False) -> Scene:
        """The present scene, velocities included: what ``reset(options={"scene": ...})`` of the model's twin takes.

        Args:
            truth: whether to give the simulator's, which its own reset takes too, instead of what is observed.
        """
        scene = self._now if truth else self._shown
        if scene is None:
            raise PwmGymError("the environment has no scene yet; call reset() first")
        return scene

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode; ``options["scene"]`` gives its scene, which needs joint positions."""
        self._check_open()
        super().reset(seed=None if seed is None else check_seed(seed))
        scene = check_options(options, ["scene"]).get("scene")
        bodies = self._start(seed) if scene is None else self._start_from(scene)
        self._stage = None
        self._observation.reset(int(self.np_random.integers(2**31)), bodies)
        self._show()
        self._show_picture()
        return self._observe(), self._info(self._judge(), self.simulator.outcome())

    def _start(self, seed: int | None) -> Bodies:
        """Begin the simulator's episode of ``seed``, or of a random one."""
        seeds = RANGES["plan_test"]
        self.simulator.reset(int(self.np_random.integers(seeds.start, seeds.stop)) if seed is None else seed)
        bodies, past = self._bodies(self.layout), None
        if isinstance(self.simulator, StartsUnderway):
            past = self.simulator.past()
        poses = np.stack([self.simulator.poses()] * 3) if past is None else past.poses
        self._poses = deque(poses, maxlen=3)
        self._scene = Scene(
            task=self.task.name,
            layout=self.layout,
            clouds=bodies.clouds,
            poses=poses,
            goal=self.simulator.goal(),
            assets=bodies.assets,
            last_action=None if past is None else past.action,
        )
        self._action = last_action(self._scene, self.task.control)
        return bodies

    def _bodies(self, layout: Layout) -> Bodies:
        """What the present episode's entities look like, of which some may follow the task's own."""
        assets, meshes = tuple(self.simulator.assets()), cache(self.simulator.meshes)
        return Bodies(layout, assets, self._clouds(assets[: len(self.layout)], meshes), meshes)

    def _start_from(self, scene: Scene) -> Bodies:
        if not isinstance(scene, Scene):
            raise PwmGymError(f"scene is a {type(scene).__name__}; expected pwm_gym.Scene")
        further = scene.layout.entities[len(self.layout) :]
        scene.validate(self.task.name, self.layout, self.task.goal_size, extra=True)
        scene = scene.coarsen(self.layout.plus(further))
        action = last_action(scene, self.task.control)
        self.simulator.restore(scene)
        bodies = self._bodies(scene.layout)
        self._scene, self._action = replace(scene, assets=bodies.assets), action
        self._poses = deque(scene.poses, maxlen=3)
        return bodies

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One control step under an action (A,) in [-1, 1]."""
        self._check_open()
        checked = check_actions(action, self.action_space.shape or ())
        self._action = checked.numpy().copy()
        outcome = self.simulator.step(self._action)
        self._poses.appendleft(self.simulator.poses())
        self._show()
        judgement = self._judge()
        info = self._info(judgement, outcome)
        self._show_picture()
        return self._observe(), float(judgement.reward[0]), outcome.success, False, info

    def _show(self) -> None:
        """Read the present scene off the simulator, and what is shown of it."""
        assert self._scene is not None
        self._now = replace(
            self._scene,
            poses=np.stack(self._poses),
            joints=self.simulator.joints(),
            last_action=self._action.copy(),
        )
        self._shown = self._observation(self._now)

    def _judge(self) -> Judgement:
        judgement = self.rules.judge(self.state, torch.as_tensor(self._action)[None], self.goal, self._stage)
        self._stage = judgement.stage
        return judgement

    def _observe(self) -> dict[str, np.ndarray]:
        return {k: v[0].numpy() for k, v in observe(self.observed_state, self.goal).items()}

    def _info(self, judgement: Judgement, outcome: SimOutcome) -> dict[str, Any]:
        return {
            **self._observation.info,
            "success": outcome.success,
            "grasped": bool(judgement.grasped[0]),
            "cost_terms": {name: float(value[0]) for name, value in judgement.terms.items()},
            "reason": "",
            **({} if judgement.stage is None else {"stage": self.rules.stage_names[int(judgement.stage[0])]}),
            "simulator_reward": outcome.reward,
            "simulator_grasped": outcome.grasped,
            "holding": ", ".join(outcome.holding),
        }

    def render(self) -> np.ndarray | None:
        """A picture (H, W, 3) uint8 with ``render_mode="rgb_array"``; with "human", every step shows itself."""
        return self._picture() if self.render_mode == "rgb_array" else None

    def _show_picture(self) -> None:
        """Show the present state in the window, where there is one."""
        if self._window is not None:
            self._window.show(self._picture())

    def _picture(self) -> np.ndarray:
        state = self.state
        if self._renderer is None or self._renderer.layout != state.layout:
            self._renderer = SceneRenderer(state.layout, "true", self._picture_camera)
        return self._renderer(state.points()[0].numpy(), self.goal[0].numpy())

    def close(self) -> None:
        """Free the simulator; calling it twice is harmless."""
        self._closed = True
        if self._window is not None:
            self._window.close()
        self.simulator.close()

    def _check_open(self) -> None:
        if self._closed:
            raise PwmGymError(f"the twin of {self.task.name} is closed; make another one")
