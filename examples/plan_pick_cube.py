"""Plan in the learned world model, execute in its simulator twin.

python examples/plan_pick_cube.py --steps 100
"""

from dataclasses import dataclass

import gymnasium as gym
import tyro

import pwm_gym


@dataclass
class Args:
    """Settings."""

    seed: int = 400_000
    """Episode of the simulator."""
    steps: int = 100
    """Actions at most."""
    samples: int = 100
    """Action sequences that the planner compares at each step."""
    horizon: int = 10
    """Steps that each looks ahead."""


def main(args: Args) -> None:
    """Run one closed-loop episode."""
    model = gym.make("pwm/PickCube-v0").unwrapped.model
    config = pwm_gym.planning.MPPIConfig(horizon=args.horizon).resize(args.samples)
    agent = pwm_gym.planning.Agent(model, "PickCube", config)

    twin = gym.make("pwm/PickCubeSim-v0")
    twin.reset(seed=args.seed)
    for step in range(args.steps):
        action = agent.act(twin.unwrapped.scene())  # 100 rollouts of the model, one action
        _, reward, success, _, info = twin.step(action)
        if step % 10 == 0 or success:
            print(f"step {step:3d}  reward {reward:.2f}  grasped {info['simulator_grasped']}")
        if success:
            print("the cube is at its goal")
            break
    twin.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
