"""A cost of your own: raise the gripper over the cube, planned and executed inside the learned model.

python examples/custom_cost.py --steps 30
"""

from dataclasses import dataclass

import gymnasium as gym
import tyro

import pwm_gym


@pwm_gym.register_cost("hover")
def hover(points, info):
    """Distance (B,) in metres of the fingers' centre from a point 15 cm over the cube."""
    fingers = (points["left_gripper"].mean(-2) + points["right_gripper"].mean(-2)) / 2
    above = points["cube"].mean(-2) + fingers.new_tensor([0.0, 0.0, 0.15])
    return (fingers - above).norm(dim=-1)


@dataclass
class Args:
    """Settings."""

    seed: int = 0
    """Scene of the checkpoint's bank and noise of the planner."""
    steps: int = 30
    """Actions."""
    samples: int = 128
    """Action sequences that the planner compares at each step."""


def main(args: Args) -> None:
    """Plan with the cost, step an environment whose reward it is."""
    env = gym.make("pwm/PickCube-v0", cost="hover")
    config = pwm_gym.planning.MPPIConfig().resize(args.samples)
    agent = pwm_gym.planning.Agent(env.unwrapped.model, "PickCube", config, cost="hover", seed=args.seed)
    env.reset(seed=args.seed)
    for step in range(args.steps):
        _, reward, _, _, info = env.step(agent.act(env.unwrapped.scene()))
        if step % 5 == 0 or step == args.steps - 1:
            print(f"step {step:3d}  {-1e3 * reward:6.1f} mm from the point over the cube  {info['cost_terms']}")
    env.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
