"""What a plan knows of a scene's surroundings."""

from dataclasses import replace

import pytest
import torch

from pwm_gym.dynamics import CompactModel
from pwm_gym.dynamics.compact import CompactConfig
from pwm_gym.dynamics.compact.plan import Plan
from pwm_gym.scene import Layout, RigidState, Support

TABLE = Support((0.5, 0.0, -0.1, 1.0, 0.0, 0.0, 0.0), (0.3, 0.2, 0.1))  # its top is at height 0
SHELF = Support((0.7, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.02))
SLANTED = Support((0.5, 0.0, 0.2, 0.966, 0.259, 0.0, 0.0), (0.3, 0.2, 0.1))


def layout(*supports):
    return Layout.build([("hand", 8), ("cube", 8)], driven=("hand",), supports=[*supports, Support.ground(-0.4)])


def surface(scene, *places):
    plan = Plan.build(scene, scene.robot(), torch.device("cpu"))
    return plan.surface(torch.tensor([places])).squeeze(0).tolist()


def test_what_lies_below_is_the_highest_top_under_a_place():
    found = surface(layout(TABLE, SHELF), (0.5, 0, 0.1), (0.7, 0, 0.1), (0.7, 0, 0.5), (0.5, 0.3, 0.1), (0.5, 0, -0.3))
    assert found == pytest.approx([0.0, 0.0, 0.32, -0.4, -0.4])


@pytest.mark.parametrize("supports", [(), (SLANTED,)])
def test_without_a_level_box_it_is_the_floor(supports):
    assert surface(layout(*supports), (0.5, 0.0, 0.3), (5.0, 5.0, 5.0)) == pytest.approx([-0.4, -0.4])


def test_links_are_told_of_tables():
    """A hand over a table is told something else than one beside it; a model without tables tells them the same."""
    torch.manual_seed(0)
    scene = layout(replace(TABLE, half=(0.3, 0.2, 0.1)))
    frames = torch.eye(4).repeat(2, 3, 2, 1, 1)
    frames[:, :, 0, 2, 3] = 0.005
    frames[0, :, 0, 0, 3], frames[1, :, 0, 0, 3] = 0.5, 5.0
    points = 0.01 * torch.rand(2, scene.points, 3)
    for tables in (True, False):
        model = CompactModel(scene, config=CompactConfig(tables=tables)).requires_grad_(False)
        told = []
        hook = model.shapes.register_forward_hook(lambda module, inputs, output, told=told: told.append(inputs[4]))
        model.step(model.prepare(RigidState(scene, points, frames)), torch.zeros(2, model.action_size))
        hook.remove()
        below = torch.as_tensor(told[0]).expand(2, 1).squeeze(1).tolist()
        assert below == pytest.approx([0.0, -0.4] if tables else [-0.4, -0.4])
