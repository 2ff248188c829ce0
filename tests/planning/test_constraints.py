import pytest
import torch

from pwm_gym.errors import PwmGymError
from pwm_gym.planning import Agent, MPPIConfig, keep_clear, workspace

INFO = {"action": torch.zeros(2, 7)}


def points(shift):
    """Two scenes: the cube at the origin, the hand ``shift`` metres along x, both of two points."""
    cube = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.02]]] * 2)
    return {"cube": cube, "hand": cube + torch.tensor(shift)[:, None, None] * torch.tensor([1.0, 0.0, 0.0])}


def test_a_workspace_counts_how_far_the_farthest_point_is_outside():
    box = workspace((-0.1, -0.1, -0.01), (0.1, 0.1, 0.1), ["hand"])
    torch.testing.assert_close(box(points([0.05, 0.25]), INFO), torch.tensor([0.0, 0.15]))
    low = workspace((-0.1, -0.1, 0.005), (0.1, 0.1, 0.1), ["cube", "hand"])
    torch.testing.assert_close(low(points([0.05, 0.05]), INFO), torch.full((2,), 0.01))


def test_clearance_is_a_share_of_the_distance():
    clear = keep_clear(["cube"], ["hand"], distance=0.04)
    torch.testing.assert_close(clear(points([0.05, 0.03]), INFO), torch.tensor([0.0, 0.25]))


def test_errors_name_the_value():
    with pytest.raises(PwmGymError, match=r"workspace from \(0, 0, 0\) to \(1, 0, 1\)"):
        workspace((0, 0, 0), (1, 0, 1), ["hand"])
    with pytest.raises(PwmGymError, match="distance=0.0; expected more than 0"):
        keep_clear(["cube"], ["hand"], distance=0.0)
    with pytest.raises(PwmGymError, match="cube cannot keep clear of itself"):
        keep_clear(["cube"], ["hand", "cube"])


def test_a_penalty_keeps_the_hand_where_it_may_be(env, scene):
    """A cost that draws the hand upwards, with and without a lid."""

    def up(points, info):
        return -points["hand"].mean(-2)[..., 2]

    def heights(penalties):
        config = MPPIConfig(samples=64, elites=8, horizon=5)
        agent = Agent(env.unwrapped.model, "PickCube", config, cost=up, penalties=penalties)
        agent.reset(0)
        agent.look(scene)
        return [float(agent.advance(agent.act()).entity("hand")[..., 2].amax()) for _ in range(6)]

    start = float(torch.as_tensor(env.unwrapped.state.entity("hand"))[..., 2].amax())
    lid = workspace((-1, -1, -1), (2, 1, start + 0.01), ["hand"])
    free, confined = heights(None), heights({"lid": (100.0, lid)})
    assert free[-1] > start + 0.05
    assert max(confined) < start + 0.015
