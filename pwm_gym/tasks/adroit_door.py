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
from pwm_gym.scene.poses import compose
from pwm_gym.sim.mujoco.adroit import OPEN, door_simulator
from pwm_gym.skills import HandReach
from pwm_gym.tasks.registry import Task, register_task

__all__ = ["ADROIT_DOOR", "AdroitDoorExplorer"]

_JOINTS = {
    "frame": FIXED,
    "door": Joint("revolute", "frame", (0.6, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 1.57),
    "latch": Joint("revolute", "door", (-0.46, 0.0, -0.025, 1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0, 1.8),
}
_LAYOUT = layout(dict.fromkeys(_JOINTS, 200), _JOINTS)
_HANDLE = np.array([0.15, -0.15, 0.0, 1.0, 0.0, 0.0, 0.0])  # in the latch's frame
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
class AdroitDoorExplorer:
    """Reaches the handle, bends the fingers there, turns and pulls: exploration, which seldom opens the door."""

    reach: HandReach
    aside: np.ndarray
    """From the handle's middle (3,), metres."""
    wrist: np.ndarray
    pull: np.ndarray
    """Way (3,) from the handle once it is held."""
    roll: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> AdroitDoorExplorer:
        """Explorer of a random way."""
        pull = np.array([rng.uniform(-0.2, 0.1), rng.uniform(-0.4, 0.0), rng.uniform(-0.3, 0.05)])
        reach = HandReach(DOOR_ARM, rng.uniform(2.5, 5.0))
        return cls(reach, rng.normal(0.0, 0.03, 3), rng.uniform(-1.0, 1.0, 2), pull, rng.uniform(-0.2, 1.0))

    def act(self, poses: np.ndarray, goal: np.ndarray, assets: Sequence[str] = ()) -> np.ndarray:
        """Action (28,) for poses (28, 7) of the hand's links, the frame, the door and its latch."""
        handle = compose(poses[_LAYOUT.index("latch")], _HANDLE)[:3]
        held = np.linalg.norm(self.reach.place(poses) - handle - self.aside) < 0.05
        if held:
            return self.reach.act(poses, handle + self.pull, 0.8, self.wrist, self.roll)
        return self.reach.act(poses, handle + self.aside, 0.2, self.wrist)


ADROIT_DOOR = register_task(
    Task(
        name="AdroitHandDoor",
        description="Turn the latch and open the door with a hand of 24 joints.",
        layout=_LAYOUT,
        robot=DOOR_HAND,
        simulator=door_simulator,
        expert=AdroitDoorExplorer.sample,
        expert_steps=100,
        cost="adroit_door",
        plan_cost="adroit_door_plan",
        success="adroit_door",
        max_episode_steps=200,
    )
)
