"""Train SAC inside the learned world model, evaluate it in the simulator twin.

The default is a short run that shows the plumbing; a policy that reaches the cube takes about 100,000 steps.

python examples/train_sac.py --steps 20000
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import tyro
from stable_baselines3 import SAC

import pwm_gym  # noqa: F401  (registers the environments)
from pwm_gym.wrappers import EntityPoses, SB3VecEnv


@dataclass
class Args:
    """Settings."""

    steps: int = 2000
    """Environment steps inside the model."""
    num_envs: int = 16
    """Model environments in one batch."""
    episodes: int = 2
    """Evaluation episodes in the simulator."""
    episode_steps: int = 50
    """Actions an evaluation episode at most."""
    seed: int = 0
    """Of the policy and the scenes."""


def main(args: Args) -> None:
    """Learn in the model, test in the simulator."""
    batch = gym.make_vec("pwm/PickCube-v0", num_envs=args.num_envs, autoreset_mode="SameStep")
    policy = SAC("MlpPolicy", SB3VecEnv(batch), seed=args.seed, learning_starts=500, verbose=0)
    policy.learn(args.steps, progress_bar=False)
    print(f"learned for {policy.num_timesteps} steps inside the model")

    twin = EntityPoses(gym.make("pwm/PickCubeSim-v0", max_episode_steps=args.episode_steps))
    returns = []
    for episode in range(args.episodes):
        observation, _ = twin.reset(seed=400_000 + episode)
        total, done = 0.0, False
        while not done:
            action, _ = policy.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, _ = twin.step(action)
            total, done = total + float(reward), terminated or truncated
        returns.append(total)
    print(f"return in the simulator {np.mean(returns):.2f} over {args.episodes} episodes")
    twin.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
