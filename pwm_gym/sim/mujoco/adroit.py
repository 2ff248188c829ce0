"""The Adroit tasks of Gymnasium-Robotics as simulators."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pwm_gym.robots import Robot
from pwm_gym.robots.adroit import DOOR_HAND, RELOCATE_HAND
from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.worlds import make_environment
from pwm_gym.sim.protocol import SimOutcome

__all__ = ["NEAR", "OPEN", "AdroitWorld", "door_simulator", "relocate_simulator"]

OPEN = 1.35
"""Radians from which on the door counts as open."""
NEAR = 0.1
"""Metres from its goal within which the ball is there."""

_KNUCKLES = tuple(f"{finger}knuckle" for finger in ("ff", "mf", "rf", "lf"))
_KNUCKLE = 0.01  # metres: radius of the finger that begins there


class AdroitWorld:
    """An Adroit environment that steps its model itself; its goal is where a site of the model stands, if any.

    Args:
        env_id: Gymnasium id, such as ``"AdroitHandRelocate-v1"``.
        target: site that is the goal.
    """

    def __init__(self, env_id: str, target: str | None = None) -> None:
        self.env = make_environment(env_id)
        self.model, self.data = self.env.model, self.env.data
        self.action_size = int(np.prod(self.env.action_space.shape))
        self.period = float(self.env.dt)
        self.frame_skip = int(self.env.frame_skip)
        self._target = None if target is None else self.model.site(target)
        self.reward = 0.0
        """The environment's own reward of the last step."""
        self.observation = np.zeros(self.env.observation_space.shape)
        """What the environment showed (39,) when it was reset or stepped last. After a step its sites lag by 2 ms."""

    def reset(self, seed: int) -> None:
        """Start the environment's episode of ``seed``."""
        self.observation = self.env.reset(seed=int(seed))[0]

    def show(self, positions: np.ndarray, velocities: np.ndarray, **places: np.ndarray) -> None:
        """Go to a state of the environment, and observe it.

        Args:
            positions: of all joints (nq,), radians and metres.
            velocities: of all joints (nv,), these a second.
            places: what the environment's state names besides (3,), metres: ``door_body_pos``; ``obj_pos``, where the
                ball is when its joints are at 0, and ``target_pos``.
        """
        self.clear()
        self.env.set_env_state({"qpos": positions, "qvel": velocities, **places})
        self.observation = self.env._get_obs()

    def clear(self) -> None:
        """Go to the initial positions."""
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.env.init_qpos

    def step(self, action: np.ndarray) -> None:
        """The environment's own step."""
        self.observation, reward, *_ = self.env.step(action)
        self.reward = float(reward)

    def drive(self, action: np.ndarray) -> None:
        """Set the actuators' controls as the environment's step does for an action (A,)."""
        self.data.ctrl[:] = self.env.act_mean + np.clip(action, -1.0, 1.0) * self.env.act_rng

    def settle(self) -> None:
        """Nothing: the model's steps are all."""

    def goal(self) -> np.ndarray:
        """Place (3,) of the target; (0,) where there is none."""
        return np.zeros(0) if self._target is None else np.array(self._target.pos, float)

    def set_goal(self, goal: np.ndarray) -> None:
        """Put the target at ``goal`` (3,)."""
        if self._target is not None:
            self._target.pos[:] = goal

    def close(self) -> None:
        """Free the environment's renderer; calling it twice is harmless."""
        if self.env is not None:
            self.env.close()
            self.env = None


def door_simulator() -> MujocoSimulator:
    """AdroitHandDoor: the door's frame stands elsewhere in each episode."""

    def judge(simulator: MujocoSimulator) -> SimOutcome:
        data = simulator.data
        opened = float(data.joint("door_hinge").qpos[0])
        way = float(np.linalg.norm(data.site("S_grasp").xpos - data.site("S_handle").xpos))
        reward = 0.1 * way - 0.1 * (opened - 1.57) ** 2 - 1e-5 * float(np.square(data.qvel).sum())
        reward += 2.0 * (opened > 0.2) + 8.0 * (opened > 1.0) + 10.0 * (opened > OPEN)
        return SimOutcome(reward, opened >= OPEN, False)

    objects = {name: name for name in ("frame", "door", "latch")}
    return _simulator(AdroitWorld("AdroitHandDoor-v1"), DOOR_HAND, objects, judge, placed=["frame"])


def relocate_simulator() -> MujocoSimulator:
    """AdroitHandRelocate: ball and goal are elsewhere in each episode."""

    def judge(simulator: MujocoSimulator) -> SimOutcome:
        data = simulator.data
        ball, palm, goal = data.body("Object").xpos, data.site("S_grasp").xpos, data.site("target").xpos
        way = float(np.linalg.norm(ball - goal))
        reward = 0.1 * float(np.linalg.norm(palm - ball))
        if ball[2] > 0.04:
            reward += 1.0 - 0.5 * float(np.linalg.norm(palm - goal)) - 0.5 * way
        reward += 10.0 * (way < NEAR) + 20.0 * (way < 0.05)
        return SimOutcome(reward, way < NEAR, False)

    world = AdroitWorld("AdroitHandRelocate-v1", "target")
    return _simulator(world, RELOCATE_HAND, {"ball": "Object"}, judge)


def _simulator(
    world: AdroitWorld,
    robot: Robot,
    objects: Mapping[str, str],
    judge: Callable[[MujocoSimulator], SimOutcome],
    placed: Sequence[str] = (),
) -> MujocoSimulator:
    """A task whose public frame is MuJoCo's world.

    All surfaces are the capsules and boxes that collide. The knuckles have none; they are shown as balls, as the ends
    of the fingers that begin there.
    """
    import trimesh

    ball = trimesh.creation.icosphere(2, _KNUCKLE)
    bodies = {**robot.links, **objects}
    surfaces = dict.fromkeys(_KNUCKLES, ball)
    return MujocoSimulator(world, bodies, judge, control=robot.control, surfaces=surfaces, placed=placed)
