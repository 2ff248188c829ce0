import torch

from pwm_gym.data import Windows
from pwm_gym.data.augment import _AXES, Reframed, reframe
from pwm_gym.scene import RigidState


def windows_of(split, batch=64, horizon=3):
    windows = Windows(split)
    frames = torch.arange(5, 5 + batch)
    return windows.at(frames, horizon, torch.Generator())


def worlds(batch):
    """World points (B, 3 + H, N, 3) of a batch's history and future."""
    poses = torch.cat([batch.frames, batch.following], 1)
    return torch.stack([RigidState(batch.layout, batch.clouds, poses[:, [k] * 3]).points() for k in range(6)], 1)


def test_axes_are_the_24_rotations_of_a_cube():
    assert _AXES.shape == (24, 3, 3)
    assert len({tuple(m.flatten().tolist()) for m in _AXES}) == 24
    assert torch.equal(torch.linalg.det(_AXES), torch.ones(24))


def test_the_world_stays_and_the_axes_of_objects_change(train_split):
    before = windows_of(train_split)
    after = reframe(before, torch.Generator().manual_seed(0))
    torch.testing.assert_close(worlds(after), worlds(before), atol=1e-6, rtol=0)
    cube = before.layout.index("cube")
    turned = (after.frames[:, 0] - before.frames[:, 0]).abs().amax((-1, -2)) > 0.1  # (B, E)
    assert turned[:, cube].float().mean() > 0.8
    assert not turned[:, [k for k in range(4) if k != cube]].any()
    for name in ("actions", "joints", "following_joints"):
        assert getattr(after, name) is getattr(before, name)


def test_an_objects_axes_are_the_same_all_along_a_window(train_split):
    before = windows_of(train_split)
    after = reframe(before, torch.Generator().manual_seed(0))
    cube = before.layout.index("cube")
    turns = [
        a[:, k, cube, :3, :3].transpose(1, 2) @ b[:, k, cube, :3, :3]
        for a, b in ((before.frames, after.frames), (before.following, after.following))
        for k in range(3)
    ]
    for turn in turns[1:]:
        torch.testing.assert_close(turn, turns[0], atol=1e-5, rtol=0)
    assert len({tuple(m.round().flatten().tolist()) for m in turns[0]}) > 12  # and each window draws its own


def test_a_window_is_drawn_with_its_axes_by_the_generator_alone(train_split):
    windows = Reframed(Windows(train_split))
    a, b, c = (windows.sample(torch.Generator().manual_seed(s), 16, 3) for s in (1, 1, 2))
    assert torch.equal(a.clouds, b.clouds) and torch.equal(a.frames, b.frames)
    assert not torch.equal(a.clouds, c.clouds)
