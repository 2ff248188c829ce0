import pytest
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.dynamics.response import EndEffector
from pwm_gym.scene import RigidState
from pwm_gym.scene.se3 import make_pose, rotation_from_vector
from pwm_gym.tasks import get_task

LAYOUT = get_task("PickCube").layout.truncate(24)


@pytest.fixture
def hand_scenes():
    """``hand_scenes(batch, moving)``: Panda hands over cubes, with random small motions or at rest."""

    def make(batch: int = 4, moving: bool = True, seed: int = 0) -> RigidState:
        generator = torch.Generator().manual_seed(seed)

        def draw(*shape):
            return torch.rand(batch, *shape, generator=generator) * 2 - 1

        clouds = 0.04 * draw(LAYOUT.points, 3)
        down = torch.as_tensor(Rotation.from_rotvec([torch.pi, 0, 0]).as_matrix()).float()
        steps = torch.arange(3).view(1, 3, 1) * (1.0 if moving else 0.0)
        root = make_pose(
            rotation_from_vector(0.3 * draw(1, 3) - 0.03 * steps * draw(1, 3)) @ down,
            torch.tensor([0.6, 0.0, 0.25]) + 0.1 * draw(1, 3) - 0.01 * steps * draw(1, 3),
        )  # (B, 3, 4, 4), newest first
        openings = 0.02 + 0.015 * draw(1, 2) - 0.001 * steps * draw(1, 2)
        cube = make_pose(
            rotation_from_vector(draw(1, 3) - 0.02 * steps * draw(1, 3)),
            torch.tensor([0.6, 0.0, 0.1]) + 0.1 * draw(1, 3) - 0.005 * steps * draw(1, 3),
        )
        fingers = EndEffector(LAYOUT).links(root, openings)
        return RigidState(LAYOUT, clouds, torch.cat([root.unsqueeze(2), fingers, cube.unsqueeze(2)], 2))

    return make
