"""AdroitHandDoor: turn the latch and open the door (Gymnasium-Robotics ``AdroitHandDoor-v1``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pwm_gym.costs import Points, doors, register_success, register_terms, terms
from pwm_gym.costs.adroit import PALM_PLACE, distance, squared_speeds
from pwm_gym.robots.adroit import DOOR_ARM, DOOR_HAND, layout
from pwm_gym.scene import FIXED, Joint
from pwm_gym.scene.poses import compose, turn_between
from pwm_gym.sim.mujoco.adroit import OPEN, door_simulator
from pwm_gym.skills import HandReach
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["ADROIT_DOOR", "AdroitDoorExpert"]

_JOINTS = {
    "frame": FIXED,
    "door": Joint("revolute", "frame", (0.6, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 1.57),
    "latch": Joint("revolute", "door", (-0.46, 0.0, -0.025, 1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0, 1.8),
}
_LAYOUT = layout(dict.fromkeys(_JOINTS, 200), _JOINTS)
_HANDLE = np.array([0.15, -0.15, 0.0, 1.0, 0.0, 0.0, 0.0])  # in the latch's frame
_FREE, _TURNED = 1.16, 0.2  # radians of the latch: free, and under way
_AJAR = 0.1  # radians of the door
_HELD = 0.06  # metres from where the handle is held
_STRAIGHT = 0.025  # bend of the fingers on their way there
_angle, _latch = doors.angle(doors.ADROIT_DOOR), doors.latch_angle(doors.ADROIT_DOOR)
_reach = distance(PALM_PLACE, doors.handle(doors.ADROIT_DOOR))
_speeds = squared_speeds({"door": None, "latch": "door"}, DOOR_HAND.control.period)

register_success("adroit_door")(doors.opened(doors.ADROIT_DOOR, OPEN))


def _shut(points: Points, info: terms.Info) -> Tensor:
    """Square (B,) of what is left to open, radians."""
    return (_angle(points, info) - 1.57).square()


def _bonus(points: Points, info: terms.Info) -> Tensor:
    """What the environment pays (B,) for a door that is ajar, wide and fully open."""
    opened = _angle(points, info)
    return 2.0 * (opened > 0.2) + 8.0 * (opened > 1.0) + 10.0 * (opened > OPEN)


register_terms(  # minus the environment's dense reward, whose first term pays for distance from the handle
    "adroit_door",
    {"distance": (-0.1, _reach), "shut": (0.1, _shut), "speeds": (1e-5, _speeds), "bonus": (-1.0, _bonus)},
)
register_terms(
    "adroit_door_plan",
    {
        "reach": (2.0, _reach),
        "latch": (-1.0, _latch),
        "open": (-4.0, _angle),
    },
)


@dataclass(frozen=True)
class AdroitDoorExpert:
    """Hooks the fingers behind the handle, presses it down with a turn of the forearm, and pulls the door open.

    Its numbers were found by the cross-entropy method in the simulator, from random ones that had opened the door.
    """

    reach: HandReach
    aside: np.ndarray
    """Place before the palm when the handle is held, from the handle's middle (3,), metres."""
    wrist: np.ndarray
    """Targets (2,) in [-1, 1]."""
    bend: float
    """Of the fingers behind the handle, 0 straight to 1."""
    press: np.ndarray
    """Way (3,) from the handle that turns the latch."""
    pull: np.ndarray
    """Way (3,) from the handle, once the latch is free."""
    rolls: tuple[float, float]
    """The forearm's turn about itself beside both ways, radians."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> AdroitDoorExpert:
        """Expert of a slightly random way."""
        return cls(
            HandReach(DOOR_ARM, rng.normal(2.84, 0.05)),
            rng.normal([0.014, -0.009, -0.026], 0.002),
            rng.normal([-0.94, 0.09], 0.02),
            rng.normal(0.77, 0.01),
            rng.normal([-0.126, 0.012, 0.036], 0.005),
            rng.normal([0.035, -0.425, 0.012], 0.005),
            (rng.normal(0.34, 0.02), rng.normal(0.62, 0.02)),
        )

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (28,) for poses (28, 7) of the hand's links, the frame, the door and its latch."""
        frame, door, latch = poses[_LAYOUT.index("frame") :]
        handle = compose(latch, _HANDLE)[:3]
        opened, turned = turn_between(frame, door), turn_between(door, latch)
        if turned > _FREE or opened > _AJAR:
            return self.reach.act(poses, handle + 0.5 * self.aside + self.pull, self.bend, self.wrist, self.rolls[1])
        held = np.linalg.norm(self.reach.place(poses) - handle - self.aside) < _HELD
        if held or turned > _TURNED:
            return self.reach.act(poses, handle + self.press, self.bend, self.wrist, self.rolls[0])
        return self.reach.act(poses, handle + self.aside, _STRAIGHT, self.wrist)


ADROIT_DOOR = register_task(
    Task(
        name="AdroitHandDoor",
        description="Turn the latch and open the door with a hand of 24 joints.",
        layout=_LAYOUT,
        robot=DOOR_HAND,
        simulator=door_simulator,
        expert=AdroitDoorExpert.sample,
        expert_steps=150,
        cost="adroit_door",
        plan_cost="adroit_door_plan",
        success="adroit_door",
        max_episode_steps=200,
    )
)
