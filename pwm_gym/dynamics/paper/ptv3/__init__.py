"""Point Transformer V3 in plain torch: installs and runs everywhere, without sparse-convolution kernels."""

from pwm_gym.dynamics.paper.ptv3.network import PointTransformer, PTv3Config

__all__ = ["PTv3Config", "PointTransformer"]
