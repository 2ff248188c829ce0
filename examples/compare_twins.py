"""How far do the learned model and the simulator agree? Step both with the same actions.

python examples/compare_twins.py --steps 60
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import tyro

import pwm_gym  # noqa: F401  (registers the environments)
from pwm_gym.tasks import get_task
from pwm_gym.wrappers import Twin


@dataclass
class Args:
    """Settings."""

    seed: int = 400_001
    """Episode of the simulator."""
    steps: int = 60
    """Actions of the scripted expert."""


def main(args: Args) -> None:
    """Print the divergence every ten steps."""
    env = Twin(gym.make("pwm/PickCube-v0"), gym.make("pwm/PickCubeSim-v0"))
    simulator = env.twin.unwrapped.simulator
    expert = get_task("PickCube").expert(np.random.default_rng(args.seed))
    env.reset(seed=args.seed)
    for step in range(1, args.steps + 1):
        action = expert.act(simulator.poses(), simulator.goal())
        _, _, terminated, truncated, info = env.step(action)
        if step % 10 == 0 or terminated:
            apart = info["divergence"]
            print(
                f"step {step:3d}  Chamfer L1 {apart['chamfer_l1'] * 1e3:5.2f} mm"
                f"  cube {apart['position']['cube'] * 1e3:5.2f} mm"
                f"  reward {apart['reward']:+.3f}"
            )
        if terminated or truncated:
            break
    env.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
