import numpy as np
import pytest
import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import Arm, Control, Gantry, GantryKinematics, SerialArm
from pwm_gym.robots.adroit import DOOR_HAND, RELOCATE_HAND
from pwm_gym.scene.se3 import matrix_from_pose7

GANTRY = RELOCATE_HAND.control.arms[0].gantry
UNIT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("robot", [DOOR_HAND, RELOCATE_HAND], ids=["door", "relocate"])
def test_inverse_kinematics_find_the_joints_behind_a_hand(robot):
    gantry = robot.control.arms[0].gantry
    kinematics = GantryKinematics(gantry)
    lower, upper = torch.tensor(gantry.lower), torch.tensor(gantry.upper)
    joints = lower + (upper - lower) * torch.rand(4, 50, gantry.joints, generator=torch.Generator().manual_seed(0))
    hand = kinematics(joints)
    assert hand.shape == (4, 50, 4, 4)
    torch.testing.assert_close(kinematics.solve(hand), joints, atol=1e-5, rtol=0)
    torch.testing.assert_close(kinematics(kinematics.solve(hand)), hand, atol=1e-5, rtol=0)
    torch.testing.assert_close(kinematics(torch.zeros(gantry.joints)), matrix_from_pose7(torch.tensor(gantry.origin)))


def test_slides_go_along_their_axes_and_turns_follow_each_other():
    kinematics = GantryKinematics(Gantry(UNIT, (2, 0), (-1.0,) * 5, (1.0,) * 5))
    pose = kinematics(torch.tensor([0.3, -0.2, 0.5, 0.0, 0.4]))
    torch.testing.assert_close(pose[:3, 3], torch.tensor([-0.2, 0.0, 0.3]))
    x, z = ([np.cos(a), np.sin(a)] for a in (0.5, 0.4))
    about_x = np.array([[1, 0, 0], [0, x[0], -x[1]], [0, x[1], x[0]]])
    about_z = np.array([[z[0], -z[1], 0], [z[1], z[0], 0], [0, 0, 1]])
    np.testing.assert_allclose(pose[:3, :3], about_x @ about_z, atol=1e-6)


def test_limits_are_springs():
    kinematics = GantryKinematics(Gantry(UNIT, (), (-1.0, 0.0, 0.0), (1.0, 2.0, 0.5)))
    limited = kinematics.limit(torch.tensor([[1.5, -5.0, 9.0]]))
    torch.testing.assert_close(limited, torch.tensor([[1.5, -1.0, 0.75]]))


def test_slides_stop_within_centimetres_of_their_limits():
    kinematics = GantryKinematics(Gantry(UNIT, (2,), (-0.3, -1.0, 0.0, 0.0), (0.5, 1.0, 2.0, 0.5)))
    limited = kinematics.limit(torch.tensor([[0.9, 1.5, -5.0, 9.0], [-0.9, 0.0, 0.0, 0.0]]))
    torch.testing.assert_close(limited, torch.tensor([[0.53, 1.5, -1.0, 0.75], [-0.33, 0.0, 0.0, 0.0]]))


def test_a_controls_gantry_survives_json():
    assert Control.from_json(RELOCATE_HAND.control.to_json()) == RELOCATE_HAND.control
    assert RELOCATE_HAND.control.arms[0].joints == slice(0, 6)
    assert DOOR_HAND.control.arms[0].joints == slice(0, 4)


@pytest.mark.parametrize(
    ("slides", "lower", "message"),
    [
        ((0, 0), (0.0,) * 5, "slides=.0, 0.; expected different axes"),
        ((3,), (0.0,) * 4, "slides=.3,.; expected different axes"),
        ((1,), (0.0,) * 3, "a gantry of 4 joints has 3 lower and 4 upper limits"),
    ],
)
def test_what_is_no_gantry_is_refused(slides, lower, message):
    with pytest.raises(PwmGymError, match=message):
        Gantry(UNIT, slides, lower, (1.0,) * (len(slides) + 3))


def test_an_arms_joints_are_told_once():
    chain = SerialArm((UNIT,), UNIT, (0.0, 0.0, 0.1), (-1.0,), (1.0,), (0.0,))
    with pytest.raises(PwmGymError, match="arm 'a' has a chain and a gantry; expected one of them"):
        Arm("a", "hand", chain, gantry=GANTRY)
