import pytest
import torch

from pwm_gym.completion import SIZES, CompletionConfig, CompletionNet, get_size
from pwm_gym.errors import PwmGymError, UnknownNameError

SMALL = CompletionConfig((64, 32, 16, 8), (8, 8, 16, 16), 4, 16, 1, 2, 16, 2, 16, 8, (2, 3), 8, 4)


def cloud(batch=2, points=64, seed=0):
    return torch.randn(batch, points, 3, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("config", [SMALL, SIZES["compact"]])
def test_levels_grow_as_the_configuration_says(config):
    torch.manual_seed(0)
    clouds, doubt = CompletionNet(config)(cloud(points=config.points[0]))
    assert [c.shape[1] for c in clouds[1:]] == list(config.levels) and doubt.shape == (2,)
    assert clouds[0].shape == (2, config.points[-1] * config.seeds, 3)
    shorter, _ = CompletionNet(config)(cloud(points=config.points[0]), steps=1)
    assert len(shorter) == 3


def test_the_sizes_are_the_papers_table():
    paper = SIZES["paper"]
    assert paper.channels == (32, 64, 128, 256) and paper.features == 512
    assert (paper.blocks, paper.heads, paper.width, paper.seeds, paper.seed_channels) == (4, 8, 384, 2, 256)
    assert paper.factors == (2, 2, 2) and paper.hidden == 64
    assert SIZES["compact"].levels[-1] == 2048


def test_clouds_of_a_batch_do_not_see_each_other():
    torch.manual_seed(0)
    net, clouds = CompletionNet(SMALL).eval(), cloud(3)
    together, doubts = net(clouds)
    for b in range(3):
        alone, doubt = net(clouds[b : b + 1])
        torch.testing.assert_close(together[-1][b], alone[-1][0], atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(doubts[b], doubt[0], atol=1e-5, rtol=1e-4)


def test_the_decoder_starts_from_the_seeds_and_the_input():
    torch.manual_seed(0)
    clouds, _ = CompletionNet(SMALL)(cloud())
    torch.testing.assert_close(clouds[1], torch.cat([clouds[0], cloud()[:, :8]], 1))


def test_every_parameter_learns():
    torch.manual_seed(0)
    net = CompletionNet(SMALL)
    clouds, doubt = net(cloud())
    (sum(c.square().mean() for c in clouds) + doubt.square().mean()).backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in net.parameters())


def test_sizes_that_cannot_be_are_refused():
    with pytest.raises(PwmGymError, match="3 stages with 4 channels"):
        CompletionConfig(points=(64, 32, 16))
    with pytest.raises(PwmGymError, match=r"points=\(32, 64, 16, 8\); expected fewer in each stage"):
        CompletionConfig(points=(32, 64, 16, 8))
    with pytest.raises(PwmGymError, match="width=100; expected a multiple of heads=8"):
        CompletionConfig(width=100)
    with pytest.raises(UnknownNameError, match="Did you mean 'compact'"):
        get_size("compct")
