"""PickSingleYCB with an object of one's choice, for trying an expert."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.root import use_assets
from pwm_gym.errors import unknown_name
from pwm_gym.robots import panda
from pwm_gym.sim.maniskill.headless import allow_headless

__all__ = ["YcbTrials"]

_NO_TIME_LIMIT = 1_000_000


class _Expert(Protocol):
    def act(self, poses: np.ndarray, goal: np.ndarray) -> np.ndarray: ...


class YcbTrials:
    """ManiSkill's PickSingleYCB on the CPU, physics only, with a Panda.

    Args:
        folder: of the objects.
    """

    def __init__(self, folder: AssetFolder) -> None:
        self._names = folder.names()
        use_assets(folder)
        import gymnasium as gym
        import mani_skill.envs  # noqa: F401  (registers the tasks)

        allow_headless()  # once more, for the modules that the import has loaded
        self.env: Any = gym.make(
            "PickSingleYCB-v1",
            num_envs=1,
            obs_mode="none",
            reward_mode="none",
            robot_uids="panda",
            control_mode="pd_ee_delta_pose",
            sim_backend="physx_cpu",
            render_backend="none",
            max_episode_steps=_NO_TIME_LIMIT,
        )

    def reset(self, name: str, seed: int) -> None:
        """Build the scene of one object and seed.

        Raises:
            UnknownNameError: the folder has no such object.
        """
        if name not in self._names:
            raise unknown_name("object", name, self._names)
        base = self.env.unwrapped
        base.all_model_ids = np.array([name])
        self.env.reset(seed=seed, options={"reconfigure": True})
        links = {link.name: link._objs[0].entity for link in base.agent.robot.get_links()}
        self._entities = [links[body] for body in panda.PANDA.links.values()] + [base.obj._objs[0]]
        self._origin = np.asarray(base.agent.robot.get_links()[0]._objs[0].entity.pose.p, float)
        self.goal = np.asarray(base.goal_site._objs[0].pose.p, float) - self._origin

    def poses(self) -> np.ndarray:
        """Poses (4, 7) of hand, fingers and object in the frame of the robot's base, which is not turned."""
        poses = [np.r_[entity.pose.p - self._origin, entity.pose.q] for entity in self._entities]
        return np.array(poses, dtype=float)

    def steps(self, name: str, seed: int, expert: _Expert, limit: int) -> int | None:
        """Control steps until success; None if there was none within ``limit``."""
        self.reset(name, seed)
        for step in range(limit):
            info = self.env.step(expert.act(self.poses(), self.goal))[-1]
            if bool(info["success"]):
                return step + 1
        return None

    def close(self) -> None:
        """Free the simulator; calling it twice is harmless."""
        if self.env is not None:
            self.env.close()
            self.env = None
