"""MugCleanup: open the drawer, put the mug into it, shut it (a ManiSkill task of our own)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, drawers, objects, register_grasp, register_success, register_terms, terms
from pwm_gym.costs.motion import joint_speed
from pwm_gym.errors import PwmGymError
from pwm_gym.robots.panda import JOINT_SPEEDS, PANDA, layout
from pwm_gym.scene import FIXED
from pwm_gym.sim import Simulator
from pwm_gym.sim.cabinet import DRAWER_JOINT
from pwm_gym.sim.mugs import get_mug
from pwm_gym.skills import CleanUp
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["MUG_CLEANUP", "MugCleanupExpert"]
