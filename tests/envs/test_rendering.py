"""Pictures and windows of environments, and the wrappers of Gymnasium that record them."""

import sys

import gymnasium as gym
import imageio_ffmpeg
import numpy as np
import pytest
import torch
from gymnasium.wrappers import RecordEpisodeStatistics, RecordVideo
from gymnasium.wrappers.vector import NumpyToTorch
from gymnasium.wrappers.vector import RecordVideo as RecordVectorVideo

import pwm_gym.envs
from pwm_gym.errors import PwmGymError, UnknownNameError

ID = "pwm/PickCube-v0"
SMALL = {"points": 40, "width": 96, "height": 64}
STILL = np.zeros(7, np.float32)


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)


def frames_of(folder):
    """Size and number of frames of the one film in a folder."""
    (path,) = folder.glob("*.mp4")
    size = next(imageio_ffmpeg.read_frames(str(path)))["size"]
    return size, imageio_ffmpeg.count_frames_and_secs(str(path))[0]


def test_pictures_have_the_size_that_is_asked_for():
    with gym.make(ID, render_mode="rgb_array", **SMALL) as env:
        env.reset(seed=0)
        wide = env.render()
        assert wide.shape == (64, 96, 3) and len(np.unique(wide.reshape(-1, 3), axis=0)) > 20
    batch = gym.make_vec(ID, num_envs=2, render_mode="rgb_array", **SMALL)
    batch.reset(seed=0)
    assert [p.shape for p in batch.render()] == [(64, 96, 3)] * 2
    for cls in (pwm_gym.envs.ModelEnv, pwm_gym.envs.SimEnv):
        with pytest.raises(PwmGymError, match="height=0; expected a whole number"):
            cls(height=0)


def test_one_environment_is_recorded(tmp_path):
    env = gym.make(ID, render_mode="rgb_array", max_episode_steps=3, **SMALL)
    env = RecordEpisodeStatistics(RecordVideo(env, str(tmp_path), episode_trigger=lambda k: k == 0))
    env.reset(seed=0)
    rewards = []
    for _ in range(3):
        _, reward, _, truncated, info = env.step(STILL)
        rewards.append(reward)
    env.close()
    assert truncated and info["episode"]["l"] == 3
    assert info["episode"]["r"] == pytest.approx(sum(rewards), abs=1e-5)
    assert frames_of(tmp_path) == ((96, 64), 4)


def test_a_batch_is_recorded(tmp_path):
    env = gym.make_vec(ID, num_envs=2, render_mode="rgb_array", **SMALL)
    env = RecordVectorVideo(env, str(tmp_path), step_trigger=lambda s: s == 0, video_length=2)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.stack([STILL] * 2))
    env.close()
    (width, height), count = frames_of(tmp_path)
    assert width * height == 2 * 96 * 64 and count >= 2


def test_a_window_shows_every_step(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # a screen that nobody sees
    with gym.make(ID, render_mode="human", **SMALL) as env, gym.make(ID, render_mode="rgb_array", **SMALL) as plain:
        assert env.metadata["render_modes"] == ["human", "rgb_array"]
        env.reset(seed=0)
        plain.reset(seed=0)
        for action in (STILL, STILL + 0.5):
            shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
            np.testing.assert_array_equal(shown, plain.render())
            env.step(action)
            plain.step(action)
        assert env.render() is None
    assert pygame.display.get_surface() is None


@pytest.mark.parametrize("cls", [pwm_gym.envs.ModelEnv, pwm_gym.envs.SimEnv])
def test_a_window_without_a_display_is_an_error(cls, no_display):
    with pytest.raises(PwmGymError, match='render_mode="human" needs a display, and neither DISPLAY nor'):
        cls(render_mode="human")


def test_a_display_that_does_not_answer_is_an_error(no_display, monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("DISPLAY", ":94")
    with (
        gym.make(ID, render_mode="human", **SMALL) as env,
        pytest.raises(PwmGymError, match='render_mode="human" cannot open a window'),
    ):
        env.reset(seed=0)


def test_a_window_without_pygame_is_an_error(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(PwmGymError, match=r"needs pygame: pip install 'pwm-gym\[video\]'"):
        pwm_gym.envs.ModelEnv(render_mode="human")


def test_a_batch_has_no_window():
    with pytest.raises(UnknownNameError, match="unknown render mode 'human'; known: rgb_array"):
        pwm_gym.envs.ModelVectorEnv(render_mode="human")


def test_infos_pass_through_the_conversion_to_tensors():
    plain = gym.make_vec(ID, num_envs=2, points=40, max_episode_steps=2)
    env = NumpyToTorch(gym.make_vec(ID, num_envs=2, points=40, max_episode_steps=2))
    plain.reset(seed=0)
    env.reset(seed=0)
    for _ in range(2):
        expected = plain.step(np.stack([STILL] * 2))
        told = env.step(torch.zeros(2, 7))
    np.testing.assert_array_equal(told[0]["points"].numpy(), expected[0]["points"])
    info = told[-1]
    assert info["success"].dtype == torch.bool and isinstance(info["cost_terms"]["reaching"], torch.Tensor)
    assert info["reason"].tolist() == ["time limit"] * 2 and type(info["reason"][0]) is str
    scene = env.unwrapped.scene(1)
    observation, _ = env.reset(options={"scene": scene})
    np.testing.assert_array_equal(observation["points"][0].numpy(), observation["points"][1].numpy())
