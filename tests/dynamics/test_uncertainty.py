import pytest
import torch

from pwm_gym.data import Windows
from pwm_gym.dynamics import build_model, rollout
from pwm_gym.dynamics.compact.uncertainty import ErrorHead
from pwm_gym.scene import batch_state, stack
from pwm_gym.tasks import get_task
from pwm_gym.training import fit_error

TASK = get_task("PickCube")
SETTINGS = {"points": 8, "point_width": 16, "width": 32, "blocks": 1, "arm_width": 16}


def test_the_head_learns_the_scale_of_errors():
    generator = torch.Generator().manual_seed(0)
    tokens = torch.randn(4000, 2, 8, generator=generator)
    scale = 1e-3 * torch.exp(tokens[..., 0])
    errors = scale * -torch.rand(scale.shape, generator=generator).log()
    torch.manual_seed(0)
    head = ErrorHead(8, 16)
    head.fit(tokens[:3000], errors[:3000], steps=400)
    told = head(tokens[3000:])
    assert (told / scale[3000:]).log().abs().mean() < 0.2
    assert not any(p.requires_grad for p in head.parameters())


@pytest.fixture(scope="module")
def model(train_split):
    batch = Windows(train_split).transitions()
    torch.manual_seed(0)
    model = build_model("compact", TASK.layout, TASK.control, SETTINGS).requires_grad_(False)
    arm = model.robot.arms[0].requires_grad_(True)
    arm.fit(batch.joints[..., :7], batch.actions[:, 0], batch.following_joints[:, 0, :, :7], steps=100, floor=0.0)
    model.requires_grad_(False).eval()
    fit_error(model, [train_split], steps=300)
    return model


def test_larger_errors_are_expected_where_they_are(model, train_split):
    batch = Windows(train_split).transitions()
    after = model.step(model.prepare(batch.state()), batch.actions[:, 0])
    gap = (after.poses() - batch.following[:, 0])[:, 3, :3, 3].norm(dim=-1)  # the cube's: an untrained model moves it
    told = after.error[:, 3]
    small, large = gap < gap.quantile(0.25), gap > gap.quantile(0.75)
    assert told[large].mean() > 2 * told[small].mean()


def test_the_expected_errors_of_steps_add_up(model, train_split):
    start = model.prepare(batch_state([train_split.scene(e) for e in train_split.episodes[:3]]))
    assert start.error.shape == (3, 4) and (start.error == 0).all()
    states = rollout(model, start, torch.zeros(3, 5, 7))
    assert states.error.shape == (3, 5, 4)
    assert (states.error.diff(dim=1) >= 0).all()


def test_training_has_no_expected_error(model, train_split):
    start = batch_state([train_split.scene(e) for e in train_split.episodes[:3]])
    assert model.train().prepare(start).error is None
    assert model.eval().prepare(start).error is not None


def test_states_carry_the_expected_error(model, train_split):
    start = model.prepare(batch_state([train_split.scene(e) for e in train_split.episodes[:3]]))
    assert stack([start, start], 1)[1:].error.shape == (2, 2, 4)
    assert start.coarsen(start.layout.truncate(5)).error is start.error
    sure = build_model("compact", TASK.layout, TASK.control, {**SETTINGS, "uncertain": False})
    assert sure.prepare(start).error is None
    assert sure.step(sure.prepare(start), torch.zeros(3, 7)).error is None
