"""3D point world models as Gymnasium environments, each with a simulator-backed twin.

>>> import gymnasium as gym
>>> import pwm_gym
>>> env = gym.make("pwm/PickCube-v0")  # the learned model; "pwm/PickCubeSim-v0" is its simulator twin
>>> observation, info = env.reset(seed=0)
>>> observation["points"].shape
(1200, 3)
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pwm_gym.costs import register_cost, register_grasp, register_success, register_terms
from pwm_gym.errors import CheckpointError, DatasetError, PwmGymError, SceneError, UnknownNameError
from pwm_gym.registration import register_envs
from pwm_gym.scene import Scene
from pwm_gym.tasks import register_task

if TYPE_CHECKING:
    from pwm_gym import (
        collection,
        data,
        dynamics,
        envs,
        evaluation,
        experiments,
        planning,
        tasks,
        training,
        viewer,
        wrappers,
    )

__version__ = "0.1.0"
__all__ = [
    "CheckpointError",
    "DatasetError",
    "PwmGymError",
    "Scene",
    "SceneError",
    "UnknownNameError",
    "agents",
    "collection",
    "data",
    "dynamics",
    "envs",
    "evaluation",
    "experiments",
    "planning",
    "register_cost",
    "register_grasp",
    "register_success",
    "register_task",
    "register_terms",
    "tasks",
    "training",
    "viewer",
    "wrappers",
]

if not Path(__file__).with_name("envs").is_dir():  # in the repository envs/ and wrappers/ stand beside the package
    __path__.append(str(Path(__file__).parents[1]))

_SUBPACKAGES = (
    "agents",
    "collection",
    "data",
    "dynamics",
    "envs",
    "evaluation",
    "experiments",
    "planning",
    "tasks",
    "training",
    "viewer",
    "wrappers",
)


def __getattr__(name: str) -> Any:
    """Subpackages are imported when first used, so that ``import pwm_gym`` stays quick."""
    if name in _SUBPACKAGES:
        return importlib.import_module(f"pwm_gym.{name}")
    raise AttributeError(f"module 'pwm_gym' has no attribute {name!r}")


register_envs()
