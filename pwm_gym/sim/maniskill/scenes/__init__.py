"""ManiSkill tasks of our own. Importing this package loads ManiSkill and registers them there.

Example:
    >>> import gymnasium as gym  # doctest: +SKIP
    >>> import pwm_gym.sim.maniskill.scenes  # doctest: +SKIP
    >>> env = gym.make("MugCleanup-v1", obs_mode="state", render_backend="none")  # doctest: +SKIP
"""

from pwm_gym.sim.maniskill.headless import allow_headless

allow_headless()  # before ManiSkill's modules hold the classes that it may have to replace

from pwm_gym.sim.maniskill.scenes.coffee import CoffeeEnv  # noqa: E402
from pwm_gym.sim.maniskill.scenes.coffee_preparation import CoffeePreparationEnv  # noqa: E402
from pwm_gym.sim.maniskill.scenes.mug_cleanup import MugChoice, MugCleanupEnv  # noqa: E402
from pwm_gym.sim.maniskill.scenes.two_arm_box_cleanup import TwoArmBoxCleanupEnv  # noqa: E402
from pwm_gym.sim.maniskill.scenes.two_arm_drawer_cleanup import TwoArmDrawerCleanupEnv  # noqa: E402

__all__ = [
    "CoffeeEnv",
    "CoffeePreparationEnv",
    "MugChoice",
    "MugCleanupEnv",
    "TwoArmBoxCleanupEnv",
    "TwoArmDrawerCleanupEnv",
]
