"""States of the Adroit tasks from what their environments observe.

An observation of Gymnasium-Robotics (``_get_obs``) tells where everything is, some of it by way of the palm: joints and
places are solved for. It tells no velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwm_gym.sim.mujoco.adroit import AdroitWorld

__all__ = ["JointState", "correct_door", "correct_relocate", "start_door", "start_relocate"]

# Of the door's observation (39,); its last component is the sign of an open door
_DOOR_HAND = slice(0, 27)  # all joints of the hand but the first, the arm's slide
_DOOR_LATCH, _DOOR_HINGE = 27, 28
_DOOR_PALM, _DOOR_HANDLE = slice(29, 32), slice(32, 35)

# Of the ball's observation (39,)
_BALL_HAND = slice(0, 30)  # all joints of the hand
_PALM_FROM_BALL, _PALM_FROM_TARGET = slice(30, 33), slice(33, 36)


@dataclass(frozen=True)
class JointState:
    """All joints of an environment."""

    positions: np.ndarray
    """(nq,), radians and metres."""
    velocities: np.ndarray
    """(nv,), these a second."""


def start_door(world: AdroitWorld, observation: np.ndarray, joints: JointState | None = None) -> None:
    """Put hand and door where an observation (39,) of ``AdroitHandDoor-v1`` has them.

    Args:
        world: of the door.
        observation: in MuJoCo's world frame, metres and radians.
        joints: of the same instant; None solves for the positions, and takes all to be at rest.
    """
    frame = np.zeros(3)
    known = _door_joints(world, observation) if joints is None else joints
    world.show(known.positions, known.velocities, door_body_pos=frame)
    frame = observation[_DOOR_HANDLE] - world.data.site("S_handle").xpos
    world.show(known.positions, known.velocities, door_body_pos=frame)


def _door_joints(world: AdroitWorld, observation: np.ndarray) -> JointState:
    """Joints at rest; the arm's slide, which is not observed, moves the palm along its axis."""
    model, data = world.model, world.data
    positions, velocities = np.zeros(model.nq), np.zeros(model.nv)
    positions[1 : model.nq - 2] = observation[_DOOR_HAND]
    positions[model.joint("door_hinge").qposadr] = observation[_DOOR_HINGE]
    positions[model.joint("latch").qposadr] = observation[_DOOR_LATCH]
    world.show(positions, velocities, door_body_pos=np.zeros(3))
    way = observation[_DOOR_PALM] - data.site("S_grasp").xpos
    positions[model.joint("ARTz").qposadr] = data.joint("ARTz").xaxis @ way
    return JointState(positions, velocities)


def start_relocate(world: AdroitWorld, observation: np.ndarray, joints: JointState | None = None) -> None:
    """Put hand, ball and target where an observation (39,) of ``AdroitHandRelocate-v1`` has them.

    Args:
        world: of the ball.
        observation: in MuJoCo's world frame, metres and radians.
        joints: of the same instant; None takes the observed ones at rest. The ball's turn is not observed.
    """
    model, data = world.model, world.data
    if joints is None:
        joints = JointState(np.zeros(model.nq), np.zeros(model.nv))
        joints.positions[_BALL_HAND] = observation[_BALL_HAND]
    world.show(joints.positions, joints.velocities, obj_pos=np.zeros(3), target_pos=np.zeros(3))
    palm = np.array(data.site("S_grasp").xpos)
    ball = palm - observation[_PALM_FROM_BALL] - data.body("Object").xpos
    target = palm - observation[_PALM_FROM_TARGET]
    world.show(joints.positions, joints.velocities, obj_pos=ball, target_pos=target)


def correct_door(world: AdroitWorld, observation: np.ndarray) -> None:
    """Move the joints by what an observation (39,) differs from the world's own; velocities stay.

    To first order in the difference: it is what a single step went wrong by.
    """
    model, data = world.model, world.data
    difference = observation - world.observation
    way = np.zeros(model.nv)
    way[1 : model.nv - 2] = difference[_DOOR_HAND]
    way[model.joint("door_hinge").dofadr] = difference[_DOOR_HINGE]
    way[model.joint("latch").dofadr] = difference[_DOOR_LATCH]
    rest = difference[_DOOR_PALM] - _palm_jacobian(world) @ way
    way[model.joint("ARTz").dofadr] = data.joint("ARTz").xaxis @ rest
    _move(world, way)


def correct_relocate(world: AdroitWorld, observation: np.ndarray) -> None:
    """Move the joints by what an observation (39,) differs from the world's own; velocities and the ball's turn stay.

    To first order in the difference: it is what a single step went wrong by.
    """
    difference = observation - world.observation
    way = np.zeros(world.model.nv)
    way[_BALL_HAND] = difference[_BALL_HAND]
    ball = world.model.joint("OBJTx").dofadr[0]
    way[ball : ball + 3] = _palm_jacobian(world) @ way - difference[_PALM_FROM_BALL]
    _move(world, way)


def _palm_jacobian(world: AdroitWorld) -> np.ndarray:
    """Way (3, nv) of the palm, metres, for each joint's radian or metre."""
    import mujoco

    jacobian = np.zeros((3, world.model.nv))
    mujoco.mj_jacSite(world.model, world.data, jacobian, None, world.model.site("S_grasp").id)
    return jacobian


def _move(world: AdroitWorld, way: np.ndarray) -> None:
    """Add to the joints' positions (nq,); all are slides and hinges."""
    import mujoco

    world.data.qpos[:] += way
    mujoco.mj_forward(world.model, world.data)
