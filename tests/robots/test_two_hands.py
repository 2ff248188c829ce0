import numpy as np
import pytest
import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.robots import ArmKinematics
from pwm_gym.robots.joints import JointTree
from pwm_gym.robots.solver import ArmSolver
from pwm_gym.robots.two_hands import (
    DRIVEN,
    FACE,
    JOINT_NAMES,
    REST,
    TWO_HANDS,
    action,
    finger_targets,
    layout,
    robot_cloud,
    tool_pose,
)

ARMS = TWO_HANDS.control.arms


def joint_vectors(count, seed=0):
    """Joint positions (count, 34) near rest, whose followers follow."""
    rng = np.random.default_rng(seed)
    joints = np.array(REST) + rng.normal(0.0, 0.2, (count, len(REST)))
    places = {name.removesuffix("_joint"): k for k, name in enumerate(JOINT_NAMES)}
    for name, joint in TWO_HANDS.joints.items():
        joints[:, places[name]] = rng.uniform(joint.lower, joint.upper, count)
    for name, joint in TWO_HANDS.joints.items():
        if joint.mimic is not None:
            leader = joints[:, places[joint.mimic.entity]]
            joints[:, places[name]] = joint.mimic.multiplier * leader + joint.mimic.offset
    return joints


def test_its_action_has_24_components_and_its_hands_six_driven_joints_each():
    assert TWO_HANDS.control.size == 24 == len(TWO_HANDS.action_names)
    assert {side: len(links) for side, links in DRIVEN.items()} == {"left": 6, "right": 6}
    assert DRIVEN["left"][:3] == ("left_thumb_1", "left_thumb_2", "left_index_1")
    followers = [name for name, joint in TWO_HANDS.joints.items() if joint.mimic is not None]
    assert len(followers) == 8 and all(name.endswith("_2") for name in followers)
    scene = layout({"box": 100})
    assert [scene.names[k] for k in scene.hands] == ["left_palm", "right_palm"]


def test_the_urdfs_links_are_where_the_known_kinematics_put_them():
    pytest.importorskip("mani_skill")
    joints = torch.as_tensor(joint_vectors(6))
    cloud = robot_cloud()
    found = cloud.poses(joints).float()
    robot = layout({}).robot()
    tree = JointTree(robot, [k for k, e in enumerate(robot) if e.joint.moves])
    hands = torch.zeros(6, len(robot), 4, 4)
    for arm in ARMS:
        hands[:, robot.index(arm.hand)] = ArmKinematics(arm.chain)(joints[:, arm.joints].float())
    names = [f"{robot.names[k]}_joint" for k in tree.moving]
    positions = joints[:, [JOINT_NAMES.index(name) for name in names]].float()
    torch.testing.assert_close(tree.place(hands, tree.limit(positions)), found, atol=1e-5, rtol=0)
    assert cloud.layout.names == robot.names and cloud.layout.points == robot.points


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_solver_agrees_with_the_batched_kinematics(arm):
    solver, known = ArmSolver(arm.chain), ArmKinematics(arm.chain)
    rng = np.random.default_rng(0)
    for _ in range(8):
        joints = np.array(arm.chain.rest) + rng.normal(0.0, 0.2, 7)
        hand = known(torch.as_tensor(joints[None]).float())[0]
        np.testing.assert_allclose(solver.tool(joints), (hand @ known.grip).numpy(), atol=1e-5)
        way, turn = rng.uniform(-0.05, 0.05, 3), rng.uniform(-0.1, 0.1, 3)
        goal = solver.target(solver.tool(joints), way, turn)
        expected = known.target(hand, torch.as_tensor(way).float(), torch.as_tensor(turn).float()) @ known.grip
        np.testing.assert_allclose(goal, expected.numpy(), atol=1e-5)
        solution, miss = solver.solve(goal, joints)
        assert miss < 1e-5
        np.testing.assert_allclose(solver.tool(solution), goal, atol=1e-4)


def test_the_solver_tells_by_how_much_it_misses_what_is_out_of_reach():
    solver, rest = ArmSolver(ARMS[0].chain), np.array(ARMS[0].chain.rest)
    goal = solver.target(solver.tool(rest), np.array([0.8, 0.0, 0.0]), np.zeros(3))
    assert solver.solve(goal, rest)[1] > 0.05


def test_tools_lie_amid_straight_fingers_and_palms_face_each_other_at_rest():
    palms = {arm.name: ArmKinematics(arm.chain)(torch.tensor([arm.chain.rest]))[0] for arm in ARMS}
    poses = np.zeros((len(TWO_HANDS.driven), 7))
    poses[:, 3] = 1.0
    for side, y in (("left", 0.3), ("right", -0.3)):
        normal, down = palms[side][:3, 0], palms[side][:3, 2]
        np.testing.assert_allclose(normal, [0.0, -np.sign(y), 0.0], atol=1e-3)
        np.testing.assert_allclose(down, [0.0, 0.0, -1.0], atol=1e-3)
        assert float(palms[side][1, 3]) == pytest.approx(y, abs=1e-3)
        np.testing.assert_allclose(tool_pose(poses, side)[:3], [-FACE, 0.0, 0.118])


def test_actions_are_told_for_both_sides():
    move = (np.array([0.05, 0.0, 0.0]), np.zeros(3), finger_targets((0.0, 0.0), 1.6))
    found = action({"left": move, "right": move})
    assert found[0] == found[12] == 0.5 and (found[6:8] == -1.0).all() and (found[8:12] == 1.0).all()
    with pytest.raises(PwmGymError, match="no motion for the right arm"):
        action({"left": move})
