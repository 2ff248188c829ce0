"""Model and simulator side by side."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import RecordConstructorArgs

from pwm_gym.envs.model_env import ModelEnv
from pwm_gym.envs.sim_env import SimEnv
from pwm_gym.errors import PwmGymError, check_whole
from pwm_gym.evaluation.metrics import chamfer
from pwm_gym.scene import Scene, State
from pwm_gym.scene.se3 import rotation_angle

__all__ = ["Twin", "divergence"]


def divergence(predicted: State, true: State) -> dict[str, Any]:
    """How far two single scenes (1,) are apart.

    Returns:
        ``chamfer_l1`` in metres, and ``position`` (metres) and ``rotation`` (degrees) of each entity by name.
    """
    a, b = predicted.poses()[0].cpu(), true.poses()[0].cpu()
    gap = (a[:, :3, 3] - b[:, :3, 3]).norm(dim=-1)
    angle = torch.rad2deg(rotation_angle(a[:, :3, :3], b[:, :3, :3]))
    names = true.layout.names
    return {
        "chamfer_l1": chamfer(predicted.points()[0].cpu().numpy(), true.points()[0].cpu().numpy()),
        "position": dict(zip(names, map(float, gap), strict=True)),
        "rotation": dict(zip(names, map(float, angle), strict=True)),
    }


def _recorded(spec: EnvSpec | None) -> EnvSpec | str | None:
    """A spec as JSON, so that it can be part of another; itself where it holds live objects."""
    if spec is None:
        return None
    try:
        return spec.to_json()
    except (TypeError, ValueError):
        return spec


class Twin(gym.Wrapper[dict[str, np.ndarray], np.ndarray, dict[str, np.ndarray], np.ndarray], RecordConstructorArgs):
    """Steps a model environment and its simulator twin together: the same scene, the same actions.

    Observations, rewards and ends are the model's. ``info["twin"]`` is the simulator's info with its
    ``reward`` and ends, and ``info["divergence"]`` tells how far the worlds are apart: ``chamfer_l1``,
    ``position`` and ``rotation`` of each entity, and ``reward`` (model's minus simulator's, of the same
    cost).

    Example:
        >>> env = Twin(gym.make("pwm/PickCube-v0"), gym.make("pwm/PickCubeSim-v0"), resync=10)
        >>> observation, info = env.reset(seed=0)
        >>> *_, info = env.step(np.zeros(7, np.float32))
        >>> sorted(info["divergence"])
        ['chamfer_l1', 'position', 'reward', 'rotation']

    Args:
        env: model environment.
        twin: simulator environment of the same task, or the id or the spec (as JSON, too) to make it from.
        resync: number of steps after which the model goes on from the simulator's scene, again and again, so that
            ``info["divergence"]`` is of predictions of at most so many; None never does.
    """

    def __init__(
        self,
        env: gym.Env[dict[str, np.ndarray], np.ndarray],
        twin: gym.Env[dict[str, np.ndarray], np.ndarray] | EnvSpec | str,
        resync: int | None = None,
    ) -> None:
        if resync is not None:
            check_whole("resync", resync, 1)
        if not isinstance(twin, gym.Env):
            is_json = isinstance(twin, str) and twin.lstrip().startswith("{")
            twin = gym.make(EnvSpec.from_json(twin) if is_json else twin)  # type: ignore[arg-type]
        RecordConstructorArgs.__init__(self, twin=_recorded(twin.spec), resync=resync)
        gym.Wrapper.__init__(self, env)
        model, simulator = env.unwrapped, twin.unwrapped
        if not isinstance(model, ModelEnv) or not isinstance(simulator, SimEnv):
            found = f"{type(model).__name__}, {type(simulator).__name__}"
            raise PwmGymError(f"Twin wraps a ModelEnv and a SimEnv; got {found}")
        if model.task.name != simulator.task.name or model.vector.layout != simulator.layout:
            raise PwmGymError(
                f"the twins differ: {model.task.name} with {model.vector.layout.points} points, "
                f"{simulator.task.name} with {simulator.layout.points}"
            )
        self.twin, self._model, self._simulator = twin, model, simulator
        self.resync, self._steps = resync, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Reset the simulator and start the model from its scene."""
        _, twin_info = self.twin.reset(seed=seed, options=options)
        scene: Scene = self._simulator.scene()
        observation, info = self.env.reset(seed=seed, options={"scene": scene})
        self._steps = 0
        return observation, self._with_divergence(info, twin_info, 0.0)

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], Any, bool, bool, dict[str, Any]]:
        """Step both; the simulator goes on after its own success until the model's episode ends."""
        if self.resync is not None and self._steps and self._steps % self.resync == 0:
            self._model.synchronise(self._simulator.scene())
        self._steps += 1
        _, twin_reward, twin_ended, twin_late, twin_info = self.twin.step(action)
        observation, reward, terminated, truncated, info = self.env.step(action)
        twin_info = {**twin_info, "reward": twin_reward, "terminated": twin_ended, "truncated": twin_late}
        gap = float(reward) - float(twin_reward)
        return observation, reward, terminated, truncated, self._with_divergence(info, twin_info, gap)

    def _with_divergence(self, info: dict[str, Any], twin_info: dict[str, Any], reward: float) -> dict[str, Any]:
        apart = divergence(self._model.state, self._simulator.state)
        return {**info, "twin": twin_info, "divergence": {**apart, "reward": reward}}

    def close(self) -> None:
        """Close both."""
        super().close()
        self.twin.close()
