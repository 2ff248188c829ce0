"""Recording of what an environment went through."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from pwm_gym.files import save_arrays
from pwm_gym.scene.se3 import pose7_from_matrix

__all__ = ["RecordRollout"]


class RecordRollout(gym.Wrapper[Any, np.ndarray, Any, np.ndarray], RecordConstructorArgs):
    """Writes each episode's poses, actions and rewards to ``folder`` as ``episode-00000.npz`` ...

    Arrays of a file: ``poses`` (T + 1, E, 7) in the base's frame, ``actions`` (T, A), ``rewards`` (T,),
    ``success`` (T,), ``goal`` (G,) and ``clouds`` (N, 3) canonical. A file appears when its episode ends or
    the next one begins.
    """

    def __init__(self, env: gym.Env[Any, np.ndarray], folder: str | Path) -> None:
        RecordConstructorArgs.__init__(self, folder=str(folder))
        gym.Wrapper.__init__(self, env)
        self.folder = Path(folder)
        self.episodes = 0
        self._clear()

    def _clear(self) -> None:
        self._poses: list[np.ndarray] = []
        self._actions: list[np.ndarray] = []
        self._rewards: list[float] = []
        self._success: list[bool] = []

    def _pose(self) -> np.ndarray:
        base: Any = self.env.unwrapped
        return pose7_from_matrix(base.state.poses()[0].double().cpu()).numpy()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset, and write the episode that was under way."""
        self.flush()
        observation, info = self.env.reset(seed=seed, options=options)
        self._poses.append(self._pose())
        return observation, info

    def step(self, action: np.ndarray) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and remember it."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._poses.append(self._pose())
        self._actions.append(np.asarray(action, np.float32))
        self._rewards.append(float(reward))
        self._success.append(bool(info["success"]))
        if terminated or truncated:
            self.flush()
        return observation, reward, terminated, truncated, info

    def flush(self) -> None:
        """Write the episode under way, if it has a step."""
        if self._actions:
            base: Any = self.env.unwrapped
            scene = base.scene(truth=True)
            arrays = {
                "poses": np.stack(self._poses),
                "actions": np.stack(self._actions),
                "rewards": np.array(self._rewards, np.float32),
                "success": np.array(self._success),
                "goal": scene.goal,
                "clouds": scene.clouds,
            }
            save_arrays(self.folder / f"episode-{self.episodes:05d}.npz", arrays)
            self.episodes += 1
        self._clear()

    def close(self) -> None:
        """Write what is left and close."""
        self.flush()
        super().close()
