import json
import socket
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pwm_gym.cli import main
from pwm_gym.completion import ObjectSet, ViewConfig, Views, load_completion, random_shapes
from pwm_gym.errors import PwmGymError, UnknownNameError
from pwm_gym.perception import clean


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    trimesh.creation.box((0.1, 0.06, 0.04)).export(folder / "brick.stl")
    trimesh.creation.icosphere(3, 0.03).export(folder / "ball.stl")
    trimesh.creation.cylinder(0.02, 0.12).export(folder / "can.stl")
    return folder


def test_held_out_meshes_are_never_viewed_in_training(folder):
    objects = ObjectSet(shapes=2, meshes=folder, held_out=("can",), share=0.8)
    assert list(objects.read()) == ["ball", "brick"] and list(objects.read(seen=False)) == ["can"]
    views = objects.views()
    assert len(views.meshes) == 4
    assert all(m.extents.max() == pytest.approx(1.0) for m in views.meshes)
    drawn = np.random.default_rng(0).choice(4, 4000, p=views._chances)
    assert (drawn < 2).mean() == pytest.approx(0.8, abs=0.03)


def test_generated_shapes_of_training_and_validation_differ():
    train, held_out = random_shapes(3), random_shapes(3, first=0)
    for a in train:
        assert all(a.vertices.shape != b.vertices.shape or not np.allclose(a.vertices, b.vertices) for b in held_out)


def test_bad_object_sets_are_named(folder):
    with pytest.raises(UnknownNameError, match=r"unknown held-out mesh 'cn'.*Did you mean 'can'"):
        ObjectSet(meshes=folder, held_out=("cn",)).read()
    with pytest.raises(PwmGymError, match="shapes=0 without meshes"):
        ObjectSet(shapes=0)
    with pytest.raises(PwmGymError, match="share=2; expected 0 to 1"):
        ObjectSet(share=2)
    with pytest.raises(PwmGymError, match="1 weights of 2 meshes"):
        Views(random_shapes(2), weights=[1.0])


def test_sensed_views_go_through_the_cleaner(folder):
    mesh = ObjectSet(shapes=0, meshes=folder).read()["ball"]
    config = replace(ViewConfig().clean(), sensed=1.0, distances=(0.6, 0.6), sizes=(0.2, 0.2), focal=(400.0, 400.0))
    gaps = []
    for cleaner in (None, clean):
        views = Views([mesh], config, cleaner=cleaner)
        clouds = [views.view(0, np.random.default_rng(seed)) for seed in range(6)]
        gaps.append(np.mean([np.abs(np.linalg.norm(v.partial - v.pose[:3, 3], axis=1) - 0.5).mean() for v in clouds]))
    assert 0 < gaps[1] < gaps[0]


def test_the_command_trains_measures_and_draws(folder, tmp_path, capsys):
    out = tmp_path / "run"
    training = ["--out", str(out), "--shapes", "4", "--phases", "1", "2", "4", "3", "1", "4"]
    meshes = ["--meshes", str(folder), "--held-out", "can"]
    files = ["--json", str(tmp_path / "found.json"), "--pictures", str(tmp_path / "drawn")]
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        main(["complete", "train", *training, *meshes, "--threads", "1"])
        trained = ["--checkpoint", str(out / "checkpoint")]
        main(["complete", "evaluate", *meshes, *trained, "--views", "1", *files, "--threads", "1"])
    _, description = load_completion(out / "checkpoint")
    assert description["training"]["objects"]["held_out"] == ["can"] and "chamfer" in description["metrics"]
    found = json.loads((tmp_path / "found.json").read_text())["rows"]
    assert set(found) == {f"{s}, {c}" for s in ("seen", "unseen") for c in ("clean", "sensor and 30 % hidden")}
    assert set(found["unseen, clean"]["objects"]) == {"can"} and found["seen, clean"]["views"] == 2
    drawn = {p.name: p.stat().st_size for p in (tmp_path / "drawn").iterdir()}
    assert set(drawn) == {"seen.png", "seen_worst.png", "unseen.png", "unseen_worst.png"} and min(drawn.values()) > 5000
    worst = [w["chamfer"] for w in found["seen, clean"]["worst"]]
    assert worst == sorted(worst, reverse=True) and np.mean(worst) == pytest.approx(found["seen, clean"]["chamfer"])
    assert "seen, clean" in capsys.readouterr().out
    main(["complete", "view", str(folder / "can.stl"), *trained, "--pictures", str(tmp_path)])
    assert (tmp_path / "can.png").exists()
    assert "can" in capsys.readouterr().out


def test_two_processes_share_the_training(tmp_path):
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    launcher = f"-m torch.distributed.run --nproc-per-node 2 --master-port {port} -m pwm_gym complete train".split()
    settings = f"--out {tmp_path} --shapes 2 --phases 1 2 4 3 1 4 --threads 1".split()
    done = subprocess.run([sys.executable, *launcher, *settings], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.count("checkpoint: ") == 1
    net, _ = load_completion(tmp_path / "checkpoint")
    assert all(p.isfinite().all() for p in net.parameters())


def test_the_command_needs_something_to_do(capsys):
    with pytest.raises(SystemExit):
        main(["complete"])
    assert "train,evaluate,view" in capsys.readouterr().err.replace(" ", "")


def test_what_cannot_be_measured_is_named_before_anything_is_loaded(folder, tmp_path):
    with pytest.raises(SystemExit, match=r"unknown held-out mesh 'cn'.*Did you mean 'can'"):
        main(["complete", "evaluate", "--meshes", str(folder), "--held-out", "cn"])
    with pytest.raises(SystemExit, match="--views 0; expected at least 1"):
        main(["complete", "evaluate", "--meshes", str(folder), "--views", "0"])
    with pytest.raises(SystemExit, match=r"cannot be written \(it is a folder\)"):
        main(["complete", "evaluate", "--meshes", str(folder), "--json", str(tmp_path)])
