import signal
import socket
import subprocess
import sys
import time
from dataclasses import asdict, replace

import pytest
import torch

from pwm_gym.data import Windows
from pwm_gym.data.episodes import KINDS
from pwm_gym.dynamics import CompactConfig, CompactModel, PaperConfig, PaperModel, build_model, load_checkpoint
from pwm_gym.errors import CheckpointError, DatasetError, UnknownNameError
from pwm_gym.learning import logging_to
from pwm_gym.robots import Arm
from pwm_gym.tasks import get_task
from pwm_gym.training import FitConfig, fit
from pwm_gym.training.losses import TrainConfig, rollout_loss, train

LAYOUT = get_task("PickCube").layout
CONTROL = replace(get_task("PickCube").control, arms=(Arm("arm", "hand"),))  # of which no joints are known
SETTINGS = {"points": 8, "point_width": 16, "width": 32, "blocks": 1}
QUICK = TrainConfig(phases=((1, 8, 16), (3, 4, 8)), validate_every=4, threads=1)


@pytest.fixture(scope="module")
def windows(train_split):
    return Windows(train_split, boost=3.0)


def compact(windows, seed=0):
    batch = windows.transitions()
    torch.manual_seed(seed)
    model = build_model("compact", LAYOUT, CONTROL, SETTINGS)
    model.robot.response.fit(batch.frames[:, :, :3], batch.actions[:, 0], batch.following[:, 0, :3])
    return model


def small_paper(seed=0):
    torch.manual_seed(seed)
    small = PaperConfig(
        encoder_depths=(1, 1, 1), encoder_channels=(8, 16, 32), encoder_heads=(2, 2, 4), encoder_patches=(64, 16, 64),
        decoder_depths=(1, 1), decoder_channels=(16, 16), decoder_heads=(2, 2), decoder_patches=(64, 16),
        bottleneck_heads=4, mlp_ratio=2, grid_size=0.01,
    )  # fmt: skip
    return PaperModel(LAYOUT, CONTROL, small)


def nothing(model):
    return {}


def keep(model, metrics):
    return None


def run(model, windows, config, folder, save=keep):
    train(model, windows, config, folder, nothing, save, progress=False)
    return {k: v.clone() for k, v in model.state_dict().items()}


def assert_equal(a, b):
    assert a.keys() == b.keys()
    assert [k for k in a if not torch.equal(a[k], b[k])] == []


def test_the_loss_goes_down(windows, tmp_path):
    config = TrainConfig(phases=((1, 150, 32),), learning_rate=1e-2, validate_every=1000, threads=1, ema_decay=0.9)
    model = compact(windows)
    model.robot.response.hand_weight.zero_()  # which leaves the network something to learn
    batch = windows.sample(torch.Generator().manual_seed(99), 256, 1)
    before = rollout_loss(model, batch, config).item()
    told = []
    with logging_to(lambda folder, step, values: told.append((folder, step, values))):
        run(model, windows, config, tmp_path)
    assert {folder for folder, *_ in told} == {tmp_path} and told[-1][1] == 150
    assert any("loss" in name for *_, values in told for name in values)
    after = rollout_loss(model, batch, config).item()
    assert after < 0.7 * before
    assert list((tmp_path / "tensorboard").iterdir())


def test_the_loss_is_the_papers_huber_on_velocities(windows):
    config = TrainConfig.paper()
    still = build_model("still", LAYOUT, CONTROL)
    batch = windows.sample(torch.Generator().manual_seed(0), 4, 5)
    state = batch.state()
    expected = []
    for k in range(5):
        after = state.advance(batch.following[:, k])
        expected.append(torch.nn.HuberLoss(delta=0.25)(torch.zeros(4, 1200, 3), after.velocity()))
        state = after
    torch.testing.assert_close(rollout_loss(still, batch, config), torch.stack(expected).mean())


def test_a_perfect_model_has_no_loss_and_objects_weigh_more(windows):
    batch = windows.sample(torch.Generator().manual_seed(0), 4, 3)

    class Replay:
        links, step_count = LAYOUT.robot(), 0

        def __init__(self, wrong):
            self.wrong = wrong

        def prepare(self, state):
            return state

        def step(self, state, action):
            poses = batch.following[:, self.step_count].clone()
            self.step_count += 1
            for i in self.wrong:
                poses[:, i, 2, 3] += 0.001
            return state.advance(poses)

    config = replace(QUICK, object_weight=2.0)
    assert rollout_loss(Replay(()), batch, config).item() < 1e-6
    hand, cube = (rollout_loss(Replay((i,)), batch, config).item() for i in (0, 3))
    assert cube == pytest.approx(2 * hand, rel=1e-3)


def test_an_interrupted_run_resumes_to_the_same_weights(windows, tmp_path):
    whole = run(compact(windows), windows, QUICK, tmp_path / "whole")
    saved = []

    def interrupt(model, metrics):
        saved.append(metrics)
        if len(saved) == 2:  # at step 8; the state on disk is step 4's
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(compact(windows), windows, QUICK, tmp_path / "cut", interrupt)
    assert torch.load(tmp_path / "cut" / "training-state.pt", weights_only=True)["step"] == 4
    resumed = run(compact(windows, seed=5), windows, QUICK, tmp_path / "cut")
    assert_equal(resumed, whole)
    other = run(compact(windows), windows, replace(QUICK, seed=1), tmp_path / "other")
    assert any(not torch.equal(other[k], whole[k]) for k in whole)  # the comparison can fail


class Cut:
    """Batches that end in an interrupt."""

    def __init__(self, windows, at):
        self.windows, self.left = windows, at

    def sample(self, generator, batch, horizon):
        if self.left == 0:
            raise KeyboardInterrupt
        self.left -= 1
        return self.windows.sample(generator, batch, horizon)


@pytest.mark.parametrize("make", [compact, lambda windows, seed=0: small_paper(seed)], ids=["compact", "paper"])
def test_a_run_cut_between_validations_resumes_to_the_same_weights(windows, tmp_path, make):
    config = replace(QUICK, phases=((1, 5, 4),), validate_every=100, save_every=2)
    whole = run(make(windows), windows, config, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run(make(windows), Cut(windows, 3), config, tmp_path / "cut")
    assert torch.load(tmp_path / "cut" / "training-state.pt", weights_only=True)["step"] == 2
    torch.rand(7)  # which moves the global generator: a network's own randomness is the step's
    assert_equal(run(make(windows, seed=5), windows, config, tmp_path / "cut"), whole)


def test_a_finished_run_is_left_alone(windows, tmp_path):
    first = run(compact(windows), windows, QUICK, tmp_path)
    saved = []
    again = run(compact(windows, seed=5), windows, QUICK, tmp_path, lambda m, metrics: saved.append(metrics))
    assert saved == []
    assert_equal(again, first)


def test_what_is_saved_is_the_average_and_what_goes_on_is_not(windows, tmp_path):
    saved = []
    run(compact(windows), windows, QUICK, tmp_path, lambda m, _: saved.append(m.movers.head.weight.detach().clone()))
    state = torch.load(tmp_path / "training-state.pt", weights_only=True)
    assert torch.equal(saved[-1], state["ema"]["movers.head.weight"])
    assert not torch.equal(state["ema"]["movers.head.weight"], state["model"]["movers.head.weight"])
    last = run(compact(windows), windows, replace(QUICK, ema_decay=0.0), tmp_path / "plain")
    state = torch.load(tmp_path / "plain" / "training-state.pt", weights_only=True)
    torch.testing.assert_close(last["movers.head.weight"], state["model"]["movers.head.weight"])


def test_another_configuration_is_refused(windows, tmp_path):
    run(compact(windows), windows, QUICK, tmp_path)
    with pytest.raises(CheckpointError, match=r"training-state\.pt was written with .*expected .*learning_rate=0\.1"):
        run(compact(windows), windows, replace(QUICK, learning_rate=0.1), tmp_path)


def test_a_state_of_another_version_is_named(windows, tmp_path):
    run(compact(windows), windows, replace(QUICK, phases=((1, 1, 4),)), tmp_path)
    path = tmp_path / "training-state.pt"
    state = torch.load(path, weights_only=True)
    assert 0.0 < state["spent"]["cpu_minutes_a_process"] < 10.0
    del state["spent"]
    torch.save(state, path)
    with pytest.raises(CheckpointError, match=r"training-state\.pt is foreign or of another version"):
        run(compact(windows), windows, replace(QUICK, phases=((1, 1, 4),)), tmp_path)


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.99])
def test_a_truncated_state_is_named(windows, tmp_path, kept):
    run(compact(windows), windows, replace(QUICK, phases=((1, 1, 4),)), tmp_path)
    path = tmp_path / "training-state.pt"
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(CheckpointError, match=r"training-state\.pt is truncated or foreign .*delete it"):
        run(compact(windows), windows, QUICK, tmp_path)


def test_the_papers_table():
    config = asdict(TrainConfig.paper(steps=10, batch=2))
    expected = {
        "phases": ((15, 10, 2),),
        "optimizer": "adamw",
        "learning_rate": 1e-4,
        "schedule": "step",
        "step_size": 30,
        "gamma": 0.1,
        "huber_delta": 0.25,
        "loss_scale": 1.0,
        "position_weight": 0.0,
        "object_weight": 1.0,
    }
    assert {k: config[k] for k in expected} == expected


@pytest.mark.parametrize(
    ("kind", "wrong", "right"),
    [("optimizer", "moun", "muon"), ("schedule", "cosin", "cosine"), ("loss", "hubr", "huber")],
)
def test_unknown_names_list_the_known_ones(kind, wrong, right):
    with pytest.raises(UnknownNameError, match=f"unknown {kind} '{wrong}'.*Did you mean '{right}'"):
        TrainConfig(**{kind: wrong})


def test_phases_follow_one_another():
    assert QUICK.steps == 12
    assert [QUICK.phase(k) for k in (0, 7, 8, 11, 50)] == [(1, 16), (1, 16), (3, 8), (3, 8), (3, 8)]


@pytest.mark.parametrize(("steps", "rate"), [(4, 1e-4), (5, 1e-5), (9, 1e-6)])
def test_the_step_schedule_drops_tenfold(windows, tmp_path, steps, rate):
    config = replace(TrainConfig.paper(), phases=((1, steps, 2),), epoch_steps=2, step_size=2, threads=1)
    run(compact(windows), windows, config, tmp_path)
    (adamw,) = torch.load(tmp_path / "training-state.pt", weights_only=True)["optimizer"]
    assert adamw["param_groups"][0]["lr"] == pytest.approx(rate)


def test_the_papers_model_trains_in_the_same_loop(windows, tmp_path):
    model = small_paper()
    before = {k: v.clone() for k, v in model.named_parameters()}
    run(model, windows, replace(TrainConfig.paper(1, 2), phases=((2, 1, 2),), threads=1), tmp_path)
    moved = [k for k, v in model.named_parameters() if not torch.equal(v, before[k])]
    assert len(moved) > 0.9 * len(before)
    assert all(v.isfinite().all() for v in model.parameters())


def fit_config(data_folder, out):
    return FitConfig(data=(data_folder,), out=out, settings=SETTINGS, arm_steps=20, error_steps=20)


def options(data_folder, out, steps):
    flat = [str(x) for pair in SETTINGS.items() for x in pair]
    given = (
        f"train --data {data_folder} --out {out} --phases 1 {steps} 16 --validate-every 5 --threads 1 "
        "--arm-steps 20 --error-steps 20 --settings"
    )
    return [*given.split(), *flat]


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_checkpoint(data_folder, tmp_path):
    config = TrainConfig(phases=((1, 60, 16),), validate_every=5, threads=1)
    out = tmp_path / "killed"
    process = subprocess.Popen(
        [sys.executable, "-m", "pwm_gym", *options(data_folder, out, 60)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    limit = time.monotonic() + 120
    while not (out / "training-state.pt").exists() and process.poll() is None and time.monotonic() < limit:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert 0 < torch.load(out / "training-state.pt", weights_only=True)["step"] < 60
    resumed = fit(fit_config(data_folder, out), config, lambda m, d, seen: {}, progress=False)
    whole = fit(fit_config(data_folder, tmp_path / "whole"), config, lambda m, d, seen: {}, progress=False)
    a, b = (load_checkpoint(folder).model for folder in (resumed, whole))
    assert_equal(a.state_dict(), b.state_dict())


def test_fit_writes_a_checkpoint_that_says_what_it_was_trained_on(data_folder, train_split, tmp_path):
    quick = replace(QUICK, phases=((1, 2, 4),))
    folder = fit(
        fit_config(data_folder, tmp_path), quick, lambda m, d, seen: {"episodes": len(d.episodes)}, progress=False
    )
    checkpoint = load_checkpoint(folder)
    assert isinstance(checkpoint.model, CompactModel) and checkpoint.model.config == CompactConfig(**SETTINGS)
    data = checkpoint.description["training"]["data"]
    assert data["transitions"] == sum(len(e) for e in train_split.episodes)
    assert sum(data["episodes"].values()) == 8 and data["episodes"]["practice"] == 4
    assert checkpoint.description["metrics"]["validation"] == {"episodes": 2}
    bank = checkpoint.bank("PickCube")
    shown = [e for e in train_split.episodes if KINDS[e.kind] != "practice"]
    assert len(bank) == len(shown) == 4  # practice starts where no episode of the task does
    assert all((bank.poses[k] == e.poses[0]).all() for k, e in enumerate(shown))


def test_a_missing_data_set_is_named(tmp_path):
    with pytest.raises(DatasetError, match=r"nowhere is not a data set"):
        fit(fit_config(tmp_path / "nowhere", tmp_path), QUICK, lambda m, d, seen: {}, progress=False)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.slow
def test_two_processes_share_the_work(data_folder, tmp_path):
    launcher = f"-m torch.distributed.run --nproc-per-node 2 --master-port {free_port()} -m pwm_gym".split()
    done = subprocess.run(
        [sys.executable, *launcher, *options(data_folder, tmp_path, 6)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-3000:]
    checkpoint = load_checkpoint(tmp_path / "checkpoint")
    assert all(p.isfinite().all() for p in checkpoint.model.parameters())
    assert torch.load(tmp_path / "training-state.pt", weights_only=True)["step"] == 6


@pytest.mark.parametrize(("points", "rows"), [(0, LAYOUT.points), (6, 24)])
def test_a_model_of_points_is_trained_on_as_many_as_it_says(windows, monkeypatch, points, rows):
    model = build_model("gbnd", LAYOUT, CONTROL, {"width": 8, "neighbours": 3, "points": points})
    seen, network = [], model.network
    monkeypatch.setattr(model, "network", lambda *a: seen.append(a[0].shape[1]) or network(*a))
    batch = windows.sample(torch.Generator().manual_seed(0), 2, 2)
    assert rollout_loss(model, batch, TrainConfig(loss_points=4)).isfinite()
    assert seen == [rows, rows]
