"""A MuJoCo model of your own, from its XML to a plan: a two-joint arm that pushes a box over a table.

python examples/own_mujoco_task.py --out push_box
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import gymnasium as gym
import numpy as np
import tyro

import pwm_gym
from pwm_gym.costs import terms
from pwm_gym.sim import SimOutcome
from pwm_gym.sim.mujoco import MujocoSimulator, layout_of, robot_of

XML = """
<mujoco><worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="upper" pos="0 0 0.05">
      <joint name="shoulder" type="hinge" axis="0 0 1" range="-150 150" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02"/>
      <body name="fore" pos="0.25 0 0">
        <joint name="elbow" type="hinge" axis="0 0 1" range="-150 150" damping="0.5"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02"/>
      </body>
    </body>
    <body name="box" pos="0 0 0.04"><freejoint/><geom type="box" size="0.04 0.04 0.04" mass="0.2"/></body>
  </worldbody><actuator>
    <motor joint="shoulder" ctrlrange="-2 2"/> <motor joint="elbow" ctrlrange="-1 1"/>
  </actuator></mujoco>"""


def start(model, data, rng):
    """Set the two joints and the box's place, and return the goal (3,), metres."""
    data.qpos[:4] = rng.uniform([1.0, 0.3, 0.27, -0.1], [1.6, 0.9, 0.35, 0.1])
    return np.append(rng.uniform([0.3, -0.35], [0.4, -0.18]), 0.04)


def judge(simulator):
    """Reward and success of the present instant."""
    far = float(np.linalg.norm(simulator.pose("box")[:3] - simulator.goal()))
    return SimOutcome(reward=1.0 - np.tanh(5.0 * far), success=far < 0.04, grasped=False)


def simulator():
    """A simulator of the model."""
    return MujocoSimulator.from_xml(XML, {name: name for name in ("upper", "fore", "box")}, start=start, judge=judge)


class Pusher:
    """Drives the arm's tip at the box, a little beside it."""

    def __init__(self, rng):
        self.aside, self.speed = rng.normal(0.0, 0.03, 2), rng.uniform(3.0, 12.0)

    def act(self, poses, goal, assets=()):
        """Action (2,) for poses (3, 7) of upper, fore and box."""
        angle = 2.0 * np.arctan2(poses[1, 6], poses[1, 3])
        tip = poses[1, :2] + 0.25 * np.array([np.cos(angle), np.sin(angle)])
        turned = np.stack([tip, tip - poses[1, :2]])[:, ::-1] * [-1.0, 1.0]  # the tip's way per radian of a joint
        asked = np.linalg.lstsq(turned.T, poses[2, :2] + self.aside - tip)[0]
        return np.clip(self.speed * asked, -1.0, 1.0).astype(np.float32)


pwm_gym.register_success("push_box")(terms.near("box", terms.goal_position, 0.04))


@pwm_gym.register_cost("push_box")
def cost(points, info):
    """The box's distance (B,) from its goal, and the forearm's from where it pushes the box there."""
    way = info["goal"] - points["box"].mean(-2)
    behind = points["box"].mean(-2) - 0.06 * way / way.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    return 5.0 * way.norm(dim=-1) + (points["fore"] - behind.unsqueeze(-2)).norm(dim=-1).amin(-1)


pwm_gym.register_task(
    pwm_gym.tasks.Task(
        name="PushBox",
        description="Push the box to its goal.",
        robot=robot_of(simulator(), "arm"),
        layout=layout_of(simulator(), points=100),
        simulator=simulator,
        expert=Pusher,
        cost="push_box",
        plan_cost="push_box",
        success="push_box",
        goal_size=3,
        max_episode_steps=60,
    )
)


@dataclass
class Args:
    """Settings."""

    out: Path | None = None
    """Folder of data set and checkpoint, which a second run goes on from; None forgets them."""
    episodes: int = 300
    """Training episodes."""
    steps: int = 1500
    """Optimiser steps on single steps; a seventh as many follow on rollouts of five."""
    plans: int = 20
    """Planned episodes."""
    max_steps: int = 60
    """Actions of an episode at most."""


def learn(args: Args, folder: Path) -> Path:
    """Collect data and train a world model; its checkpoint."""
    collecting = pwm_gym.collection.CollectConfig(
        "PushBox", out=folder / "data", episodes=args.episodes, held_out=min(20, args.episodes), workers=1
    )
    data = pwm_gym.collection.collect(collecting)
    phases = ((1, args.steps, 64), (5, args.steps // 7, 64))
    training = pwm_gym.training.TrainConfig(phases=phases, threads=1)
    settings = {"uncertain": False}  # it need not tell its own error
    fitting = pwm_gym.training.FitConfig("PushBox", data=(data,), out=folder / "run", settings=settings)
    return pwm_gym.training.fit(fitting, training, pwm_gym.evaluation.validation_metrics)


def main(args: Args) -> None:
    """Data, a world model, plans."""
    with TemporaryDirectory() as forgotten:
        checkpoint = learn(args, args.out or Path(forgotten))
        model = pwm_gym.dynamics.load_checkpoint(checkpoint).model
    agent = pwm_gym.planning.Agent(model, "PushBox")
    twin = gym.make("pwm/PushBoxSim-v0")
    seeds = range(400_000, 400_000 + args.plans)
    runs = [pwm_gym.planning.execute(twin, agent, seed, args.max_steps) for seed in seeds]
    print(f"{sum(run.success for run in runs)} of {len(runs)} boxes reached their goals")
    twin.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
