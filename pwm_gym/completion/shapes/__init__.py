"""Random watertight shapes of household kind; needs ``manifold3d``, which nothing else here loads."""

from pwm_gym.completion.shapes.families import FAMILIES, MAX_FACES, random_shape

__all__ = ["FAMILIES", "MAX_FACES", "random_shape"]
