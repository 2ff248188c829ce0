from dataclasses import replace

import pytest
import torch

from pwm_gym.scene import RigidState


@pytest.fixture
def hand_scenes(worlds):
    """``hand_scenes(batch, moving)``: Panda hands over cubes, with random small motions or at rest."""
    world = replace(worlds["cube"], points=24)

    def make(batch: int = 4, moving: bool = True, seed: int = 0) -> RigidState:
        return replace(world.state(batch, moving, seed), joints=None)

    return make


@pytest.fixture
def set_gates():
    """``set_gates(model, ...)``: gates of a compact model's movers at -20 (shut) to 20 (open), whatever it sees."""

    @torch.no_grad()
    def apply(model, moving=-20.0, flying=-20.0, fall=20.0, links=-20.0, others=-20.0, push=-20.0):
        movers = model.movers
        for layer in (movers.query, movers.key, movers.pair[-1]):
            layer.weight.zero_()
            layer.bias.zero_()
        movers.head.weight[:3] = 0.0
        movers.head.bias[:3] = torch.tensor([moving, flying, fall])
        movers.link_bias[:, 0] = torch.as_tensor(links)
        movers.kind_bias[:, 0] = torch.as_tensor(others)
        movers.link_bias[:, 1], movers.kind_bias[:, 1] = push, push
        return model

    return apply
