"""Gymnasium environments: the learned world model, its native batch, and the simulator twin."""

from pwm_gym.envs.model_env import ModelEnv
from pwm_gym.envs.model_vector_env import ModelVectorEnv
from pwm_gym.envs.observation_models import CameraConfig
from pwm_gym.envs.sim_env import SimEnv

__all__ = ["CameraConfig", "ModelEnv", "ModelVectorEnv", "SimEnv"]
