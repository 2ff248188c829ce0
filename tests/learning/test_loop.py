from dataclasses import dataclass

import pytest
import torch
from torch import nn

from pwm_gym.errors import CheckpointError, PwmGymError
from pwm_gym.learning import LoopConfig, has_state, is_main_process, run_training


@dataclass
class Numbers:
    """A batch."""

    x: torch.Tensor

    def to(self, device):
        return Numbers(self.x.to(device))


class Loss(nn.Module):
    def __init__(self, model, poison=lambda x: x):
        super().__init__()
        self.model, self.poison, self.calls = model, poison, 0

    def forward(self, batch):
        self.calls += 1
        value = (self.model(batch.x) - batch.x).square().mean()
        return self.poison(value) if self.calls == 4 else value


CONFIG = LoopConfig(phases=((1, 2, 8), (5, 3, 4)), optimizer="adamw", threads=1, ema_decay=0.5, save_every=1)


def train(folder, poison=lambda x: x, config=CONFIG, saved=None):
    torch.manual_seed(0)
    model = nn.Linear(2, 2)
    return run_training(
        model,
        Loss(model, poison),
        lambda generator, step, world: Numbers(torch.rand(4, 2, generator=generator)),
        config,
        folder,
        lambda model: {"error": 1.0},
        lambda model, metrics: None if saved is None else saved.append(metrics),
        progress=False,
    )


def test_a_training_validates_and_saves(tmp_path):
    saved = []
    assert train(tmp_path, saved=saved) == {"error": 1.0} == saved[-1]
    assert has_state(tmp_path)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_loss_that_is_not_finite_stops_the_training(tmp_path, value):
    saved = []
    with pytest.raises(PwmGymError, match=rf"the loss is {value} at step 3 of 5 \(phase 2: extent 5, batch 4\)"):
        train(tmp_path, lambda x: x * float(value), saved=saved)
    assert not saved
    state = torch.load(tmp_path / "training-state.pt", weights_only=True)
    assert state["step"] == 3 and all(v.isfinite().all() for v in state["model"].values())


def test_a_gradient_that_is_not_finite_stops_the_training(tmp_path):
    with pytest.raises(PwmGymError, match="the gradient's norm is nan at step 3"):
        train(tmp_path, lambda x: (x - x.detach()).abs().sqrt())  # 0, with a slope of 0 times infinity


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"RANK": "1"}, "RANK=1, WORLD_SIZE=None are set without WORLD_SIZE, MASTER_ADDR"),
        ({"RANK": "0"}, "start several processes with torchrun"),
        ({"WORLD_SIZE": "2"}, "without RANK"),
        ({"RANK": "1", "WORLD_SIZE": "2"}, "without MASTER_ADDR"),
        ({"RANK": "a", "WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}, "expected integers"),
        ({"RANK": "2", "WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}, "RANK=2; expected 0 to 1"),
    ],
)
def test_a_rank_without_torchrun_is_an_error(tmp_path, monkeypatch, environment, message):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(PwmGymError, match=message):
        is_main_process()
    with pytest.raises(PwmGymError, match=message):
        train(tmp_path)
    assert not list(tmp_path.iterdir())


def test_torchruns_first_process_is_the_main_one(monkeypatch):
    assert is_main_process()
    for name, value in {"RANK": "1", "WORLD_SIZE": "2", "MASTER_ADDR": "localhost"}.items():
        monkeypatch.setenv(name, value)
    assert not is_main_process()
    monkeypatch.setenv("RANK", "0")
    assert is_main_process()


@pytest.mark.parametrize(
    "change",
    [lambda s: {**{k: v for k, v in s.items() if k != "ema"}, "average": s["ema"]}, lambda s: 3, lambda s: {}],
    ids=["of the version before", "a number", "nothing"],
)
def test_a_state_of_another_version_is_refused(tmp_path, change):
    train(tmp_path)
    path = tmp_path / "training-state.pt"
    torch.save(change(torch.load(path, weights_only=True)), path)
    with pytest.raises(CheckpointError, match="of another version of pwm_gym; finish it with that one or delete it"):
        train(tmp_path)


def test_a_state_of_another_model_is_refused(tmp_path):
    train(tmp_path)
    path = tmp_path / "training-state.pt"
    state = torch.load(path, weights_only=True)
    torch.save({**state, "model": {"weight": torch.zeros(1)}}, path)
    with pytest.raises(CheckpointError, match="does not fit this model"):
        train(tmp_path)
