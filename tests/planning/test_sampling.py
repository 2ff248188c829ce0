import pytest
import torch

from pwm_gym.planning.sampling import power_law_noise


@pytest.mark.parametrize("horizon", [1, 2, 7, 10])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_power_law_noise_is_standard_normal(horizon, exponent):
    noise = power_law_noise((2, 4000, horizon, 2), exponent, torch.Generator().manual_seed(0))
    assert noise.shape == (2, 4000, horizon, 2)
    torch.testing.assert_close(noise.mean((0, 1)), torch.zeros(horizon, 2), atol=0.05, rtol=0)
    torch.testing.assert_close(noise.std((0, 1)), torch.ones(horizon, 2), atol=0.05, rtol=0)


def test_its_colour_is_the_exponent():
    noise = power_law_noise((20_000, 12, 1), 2.0, torch.Generator().manual_seed(0))[..., 0]
    power = torch.fft.rfft(noise, dim=-1).abs().square().mean(0)
    for k in (2, 3, 5):
        assert (power[1] / power[k]).item() == pytest.approx(k**2, rel=0.1)


def test_an_exponent_of_zero_is_white():
    noise = power_law_noise((20_000, 6, 1), 0.0, torch.Generator().manual_seed(0))[..., 0]
    torch.testing.assert_close(torch.corrcoef(noise.T), torch.eye(6), atol=0.04, rtol=0)
