"""The learned world model as a Gymnasium environment: a batch of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import EzPickle
from gymnasium.vector import AutoresetMode
from torch import Tensor

from pwm_gym.envs.common import Rules, check_actions, check_render_mode
from pwm_gym.envs.model_vector_env import ModelVectorEnv
from pwm_gym.envs.rendering import Window, modes_here
from pwm_gym.errors import check_seed
from pwm_gym.scene import Entity, Scene, State

__all__ = ["ModelEnv"]


class ModelEnv(EzPickle, gym.Env[dict[str, np.ndarray], np.ndarray]):
    """
    ## Description
    A learned 3D point world model. An episode starts from a scene of the checkpoint's own bank (no simulator
    is needed) or from a given one, and every ``step`` predicts the completed point cloud one control step
    (0.05 s) later.

    ## Action space
    `Box(-1, 1, (7,), float32)` for the Panda tasks (ManiSkill's `pd_ee_delta_pose`, in the robot base's
    frame):

    | index | meaning | unit of 1.0 |
    |---|---|---|
    | 0-2 | translation of the tool | 0.1 m asked for; the arm lags and makes about a third in one step |
    | 3-5 | rotation of the tool, about x, y, z | -0.1 rad (the controller's sign) |
    | 6 | gripper, absolute | 1 open, -1 shut |

    `Box(-1, 1, (24,), float32)` for the tasks of two arms with hands, of the left arm and then the right one:

    | index | meaning | unit of 1.0 |
    |---|---|---|
    | 0-2, 12-14 | translation of the tool | 0.1 m asked for |
    | 3-5, 15-17 | rotation of the tool, about x, y, z | 0.1 rad |
    | 6-11, 18-23 | thumb's swing and bend, four fingers, absolute | 1 bent, -1 straight |

    ## Observation space
    `Dict`, float32, robot base's frame; `env.unwrapped.entities` names the slices of N:

    | key | shape | meaning |
    |---|---|---|
    | points | (N, 3) | x_t in metres |
    | velocity | (N, 3) | x_t - x_{t-1}, metres a step |
    | previous_velocity | (N, 3) | x_{t-1} - x_{t-2} |
    | goal | (G,) | the task's goal, metres |

    ## Reward
    Minus the registered cost (`cost=`), by default the port of the simulator's own shaped reward to clouds.

    ## Starting state
    A random scene of the checkpoint's bank, at rest; or `reset(options={"scene": scene})`. Such a scene may have
    further free entities after the task's (clutter): they move, costs can read them, observations leave them out.

    ## Episode end
    Success terminates. A prediction that leaves the bounds truncates with
    `info["reason"] == "left the bounds"`; only the returned observation is clipped. `gym.make` adds the time
    limit.

    ## Info
    `success`, `grasped`, `cost_terms` (the cost's weighted terms by name), `reason`; of tasks that are sequences
    of stages `stage`, the present one's name; from models that tell,
    `expected_error`: how far each entity's points may be from the truth by now, metres on average.

    ## Arguments
    `render_mode` may be "human", too: a window that shows every step (extra `video`). The others are
    those of :class:`pwm_gym.envs.ModelVectorEnv` but for `num_envs`, the time limit and autoreset.

    ## Version history
    * v0: initial release.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        task: str = "PickCube",
        checkpoint: str = "default",
        cost: str | Callable[..., Tensor] | None = None,
        grasp: str | None = None,
        device: str = "cpu",
        points: int | None = None,
        render_mode: str | None = None,
        width: int = 320,
        height: int = 320,
    ) -> None:
        EzPickle.__init__(self, task, checkpoint, cost, grasp, device, points, render_mode, width, height)
        self.metadata = {**self.metadata, "render_modes": modes_here(self.metadata["render_modes"])}
        self._window = Window(self.metadata["render_fps"]) if render_mode == "human" else None
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.vector = ModelVectorEnv(
            task,
            num_envs=1,
            checkpoint=checkpoint,
            cost=cost,
            grasp=grasp,
            device=device,
            points=points,
            render_mode="rgb_array" if self._window is not None else render_mode,
            width=width,
            height=height,
            autoreset_mode=AutoresetMode.DISABLED,
        )
        self.render_mode = render_mode
        self.task, self.model = self.vector.task, self.vector.model
        self.action_space = self.vector.single_action_space
        self.observation_space = self.vector.single_observation_space

    @property
    def rules(self) -> Rules:
        """Reward, success and grasp."""
        return self.vector.rules

    def set_cost(self, cost: str | Callable[..., Tensor] | None) -> None:
        """Reward by another cost from now on, a registered or a callable one; stages begin anew."""
        self.vector.set_cost(cost)

    def synchronise(self, scene: Scene) -> None:
        """Go on from another scene; the goal, the stage and the time that has passed stay."""
        self.vector.synchronise(scene)

    @property
    def entities(self) -> tuple[Entity, ...]:
        """Entities and their slices of the points."""
        return self.vector.entities

    @property
    def state(self) -> State:
        """The present state (1,)."""
        return self.vector.state

    @property
    def observed_state(self) -> State:
        """The present state (1,) of the task's entities, which observations are of."""
        return self.vector.observed_state

    @property
    def goal(self) -> Tensor:
        """Goal (1, G)."""
        return self.vector.goal

    def scene(self, truth: bool = False) -> Scene:
        """The present scene, velocities included: what ``reset(options={"scene": ...})`` takes.

        Args:
            truth: no matter here: a model's world is as it shows it.
        """
        return self.vector.scene()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode; ``options["scene"]`` gives its scene."""
        super().reset(seed=None if seed is None else check_seed(seed))
        observation, info = self.vector.reset(seed=seed, options=options)
        self._show()
        return _first(observation), _first_info(info)

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One control step under an action (A,) in [-1, 1]."""
        batch = check_actions(action, self.action_space.shape or ()).unsqueeze(0)
        self.vector.resume()
        observation, reward, terminated, truncated, info = self.vector.step(batch)
        done = bool(terminated[0]), bool(truncated[0])
        self._show()
        return _first(observation), float(reward[0]), *done, _first_info(info)

    def render(self) -> np.ndarray | None:
        """A picture (H, W, 3) uint8 with ``render_mode="rgb_array"``; with "human", every step shows itself."""
        return None if self._window is not None else self._picture()

    def _picture(self) -> np.ndarray | None:
        pictures = self.vector.render()
        return None if pictures is None else pictures[0]

    def _show(self) -> None:
        """Show the present state in the window, where there is one."""
        if self._window is not None and (picture := self._picture()) is not None:
            self._window.show(picture)

    def close(self) -> None:
        """Close the window, where there is one."""
        if self._window is not None:
            self._window.close()


def _first(batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: value[0] for name, value in batch.items()}


def _first_info(info: dict[str, Any]) -> dict[str, Any]:
    """Plain values of the first environment, without the vector's masks."""
    out: dict[str, Any] = {}
    for name, value in info.items():
        if name.startswith("_") and name[1:] in info:
            continue
        if isinstance(value, dict):
            out[name] = _first_info(value)
        else:
            out[name] = value[0].item() if isinstance(value[0], np.generic) else value[0]
    return out
