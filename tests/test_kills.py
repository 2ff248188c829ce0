"""Processes killed at random moments lose nothing; `python benchmarks/kills.py` kills the commands themselves."""

import os
import random
import signal
import threading
import time

import numpy as np
import pytest
import torch
from kills import JOBS, finish, kill_often
from torch import nn
from tqdm import tqdm

from pwm_gym.evaluation import run_seeds
from pwm_gym.experiments.pieces import Piece, run_pieces
from pwm_gym.learning import LoopConfig, run_training
from pwm_gym.learning.weights import save_weights
from pwm_gym.planning import Run

KILLS = 3


def killed(work, seed, longest):
    """Do the work in processes, of which the first ones are killed within ``longest`` seconds, until one ends."""
    chance = random.Random(seed)
    for number in range(KILLS + 1):
        if (process := os.fork()) == 0:
            tqdm.set_lock(threading.RLock())  # the other one is shared with the parent, and would stay locked
            try:
                work()
            except BaseException:
                os._exit(1)
            os._exit(0)
        if number < KILLS:
            time.sleep(chance.uniform(0.0, longest))
            os.kill(process, signal.SIGKILL)
        _, ended = os.waitpid(process, 0)
        assert ended in (0, signal.SIGKILL), "the work failed"
    assert ended == 0


class Loss(nn.Module):
    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, batch):
        time.sleep(0.002)
        return (self.model(batch) - 1.0).square().mean()


def train(folder):
    config = LoopConfig(phases=((1, 40, 4),), optimizer="adamw", threads=1, save_every=1, validate_every=20)
    torch.manual_seed(0)
    model = nn.Linear(3, 2)
    run_training(
        model,
        Loss(model),
        lambda generator, step, world: torch.rand(4, 3, generator=generator),
        config,
        folder,
        lambda model: {},
        lambda model, metrics: save_weights(folder, model, {"format": "test"}),
        progress=False,
    )


def test_a_training_that_is_killed_ends_where_it_would_have(tmp_path):
    train(tmp_path / "plain")
    killed(lambda: train(tmp_path / "killed"), 1, 0.4)
    names = ("model.safetensors", "config.json")
    one, other = ([(tmp_path / folder / name).read_bytes() for name in names] for folder in ("plain", "killed"))
    assert one == other


def make(folder):
    time.sleep(0.02)
    return {"folder": folder.name, "rows": [0.5] * 10_000}


def test_pieces_that_are_killed_are_whole_or_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr("pwm_gym.experiments.pieces.describe_commit", lambda: "abc")
    pieces = [Piece(str(k), "piece", f"recipe {k}", tmp_path, make) for k in range(12)]

    def work():
        for piece in pieces:
            if piece.result.exists():
                assert piece.read()["folder"] == piece.folder.name
        run_pieces(pieces, tell=lambda line: None)

    killed(work, 2, 0.2)
    assert all(len(piece.read()["rows"]) == 10_000 for piece in pieces)


def test_runs_that_are_killed_are_whole_or_not_there(scene, tmp_path):
    def run_one(seed):
        time.sleep(0.01)
        steps = {"actions": np.full((3, 7), seed, np.float32), "rewards": np.zeros(3), "plan_seconds": np.zeros(3)}
        poses = np.repeat(scene.poses[:1], 4, 0)
        return Run(scene, seed, True, **steps, poses=poses, predicted=poses[1:], predicted_rewards=np.zeros(3))

    def work():
        run_seeds(run_one, range(10), progress=False, folder=tmp_path, recipe={"chunk": 1})

    killed(work, 3, 0.2)
    for seed in range(10):
        assert (Run.load(tmp_path / f"seed-{seed}.npz").actions == seed).all()


@pytest.mark.slow
@pytest.mark.parametrize("job", ["collect", "train-agent cloning"])
def test_commands_that_are_killed_lose_nothing(job, tmp_path):
    data = tmp_path / "data"
    finish(["collect", "--episodes", "4", "--held-out", "2", "--out", str(data)])
    outcome = kill_often(JOBS[job], 2, tmp_path, data, random.Random(0))
    assert outcome.kills == 2 and outcome.faults == []
