import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

import pwm_gym
import pwm_gym_cli
from pwm_gym.cli import main
from pwm_gym.data.episodes import read_shard, write_shard
from pwm_gym.dynamics.checkpoint import default_checkpoints
from pwm_gym.planning import Run
from pwm_gym.tasks import TASKS
from pwm_gym_cli import COMMANDS


def failure(*args) -> str:
    """The one line that the command ends with."""
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in args])
    message = str(end.value)
    assert message.startswith("pwm-gym: ") and "\n" not in message
    return message


def test_envs_lists_models_and_twins(capsys):
    main(["envs"])
    lines = capsys.readouterr().out.splitlines()
    assert any("pwm/PickCube-v0" in x and "world model" in x and "100 steps" in x for x in lines)
    assert any("pwm/PickCubeSim-v0" in x and "simulator twin" in x for x in lines)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    help_text = capsys.readouterr().out
    assert f"usage: pwm-gym {command}" in help_text
    assert (
        command in ("envs", "data", "view", "complete", "scenes", "average", "publish", "assets")
        or "--task" in help_text
        or "COST" in help_text.upper()
    )


def test_help_lists_every_command_and_says_what_it_does(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    told = dict(re.findall(r"^  ([a-z-]+) +([A-Z].*)$", text, re.M))
    assert tuple(told) == COMMANDS and told["envs"] == "List the registered environments."


def test_every_command_is_listed():
    modules = Path(pwm_gym.__file__).parent.glob("commands/*.py")
    runnable = {path.stem for path in modules if path.read_text().startswith('"""``pwm-gym ')}
    assert runnable == {name.replace("-", "_") for name in COMMANDS}


@pytest.mark.parametrize(("flag", "told"), [("--help", "usage: pwm-gym"), ("--version", pwm_gym.__version__)])
def test_help_and_version_import_neither_the_package_nor_torch(flag, told):
    code = f"""
import sys, pwm_gym_cli
try:
    pwm_gym_cli.main(["{flag}"])
finally:
    print(sorted({{"pwm_gym", "torch", "gymnasium", "numpy", "tyro"}} & sys.modules.keys()))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert told in run.stdout and run.stdout.endswith("[]\n"), run.stderr


@pytest.mark.parametrize("args", [["--help"], ["average", "--help"], ["envs"]])
def test_output_that_nobody_reads_any_more_ends_quietly(args):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-c", "import pwm_gym_cli; pwm_gym_cli.main()", *args]
    try:
        run = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, timeout=60)
    finally:
        os.close(write)
    assert run.returncode == 1 and "BrokenPipe" not in run.stderr


def test_a_broken_pipe_of_a_worker_is_an_error(monkeypatch):
    def broken(name, args):
        raise BrokenPipeError("of a worker")

    monkeypatch.setattr(pwm_gym_cli, "_run", broken)
    with pytest.raises(BrokenPipeError, match="of a worker"):
        pwm_gym_cli.main(["envs"])


def test_without_a_command_help_goes_to_the_other_stream(capsys):
    with pytest.raises(SystemExit) as end:
        main([])
    assert end.value.code == 2 and "usage: pwm-gym" in capsys.readouterr().err


def test_an_unknown_command_lists_the_known_ones():
    assert failure("trian").endswith("assets. Did you mean 'train'?")


@pytest.mark.parametrize(
    ("command", "groups"), [("train", ("fit", "training")), ("complete train", ("objects", "training"))]
)
def test_long_lists_of_options_are_grouped(command, groups, capsys):
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    for group in groups:
        assert f"{group} options" in text
    assert "--training." not in text


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["collect", "--task", "PickCub", "--out"], "unknown task 'PickCub'; known: "),
        (["plan", "--checkpoint", "nothing"], "unknown checkpoint 'nothing'; known: "),
        (["demo", "--checkpoint", "pand"], "Did you mean 'panda'?"),
        (["plan", "--planner", "mpi"], "Did you mean 'mppi'?"),
        (["view", "nothing.npz"], "nothing.npz"),
        (["plan", "--seeds", "plan_tst"], "unknown range of seeds 'plan_tst'; known: plan_test, plan_validation, "),
        (["train", "--data", "nowhere", "--out"], "nowhere is not a data set"),
        (["evaluate", "--data", "nowhere"], "it has no dataset.json (`pwm-gym collect` makes one)"),
        (["data", "export", "--data", "nowhere"], "nowhere is not a data set"),
        (["data", "import", "pwm/none-v0", "--out"], "Minari has no data set 'pwm/none-v0' on this machine"),
        (["evaluate", "--task", "Pick", "--data", "nowhere"], "unknown task 'Pick'"),
        (["check-cost", "--cost", "pick_cubes"], "unknown cost 'pick_cubes'; known: "),
        (["plan", "--cost", "pick_cubes"], "unknown cost 'pick_cubes'; known: "),
        (["demo", "--cost", "nothing.py:cost"], "no file 'nothing.py'"),
        (["demo", "--task", "Pick"], "unknown task 'Pick'"),
        (["collect", "--episodes", "-3"], "episodes=-3; expected at least 1"),
        (["collect", "--on-policy", "1", "--practice", "0", "--policy", "nowhere"], "unknown policy 'nowhere'"),
        (["complete", "evaluate", "--meshes", "nowhere"], "nowhere"),
        (["evaluate", "--table", "horizn"], "Did you mean 'horizon'"),
        (["evaluate", "--table", "shared"], "expected --checkpoints FOLDER"),
        (["plan", "--episodes", "0"], "--episodes 0; expected at least 1"),
        (["evaluate", "--table", "register", "--scale", "0"], "--scale 0.0; expected a share above 0 and up to 1"),
        (["plan", "--max-steps", "0"], "--max-steps 0; expected at least 1"),
        (["plan", "--offset", "-5"], "--offset -5; expected at least 0"),
        (["plan", "--offset", "99999"], "plan_test has 100000 seeds; 99999 + 20 were asked for"),
        (["demo", "--episodes", "0"], "--episodes 0; expected at least 1"),
        (["evaluate", "--table", "distractors", "--episodes", "0"], "--episodes 0; expected at least 1"),
        (["evaluate", "--every", "0"], "--every 0; expected at least 1"),
        (["evaluate", "--objects", "unseen"], "--objects unseen; expected a --table that plans"),
        (["evaluate", "--table", "distractors", "--objects", "seen"], "has the objects of the checkpoint's scenes"),
        (
            ["evaluate", "--table", "planning", "--fit-data", "mine"],
            "--fit-data mine; a table's baselines are fitted on",
        ),
        (["evaluate", "--table", "planning", "--objects", "seen"], "the objects of PickCube are always the same"),
        (["evaluate"], "data-sets/PickCube is not a data set"),
        (["train"], "data-sets/PickCube is not a data set"),
    ],
)
def test_errors_about_input_are_one_line(args, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    if args[-1] == "--out":
        args = [*args, tmp_path / "out"]
    assert message in failure(*args)


def test_a_task_without_a_shipped_checkpoint_says_how_to_train_one(monkeypatch):
    monkeypatch.setitem(TASKS, "Juggle", replace(TASKS["PickCube"], name="Juggle"))
    message = failure("demo", "--task", "Juggle")
    shipped = ", ".join(sorted(default_checkpoints()))
    assert f"no checkpoint of task 'Juggle' is shipped (shipped: {shipped})" in message
    assert "`pwm-gym collect --task Juggle` and `pwm-gym train --data data-sets/Juggle`" in message


def test_a_rank_without_torchrun_is_one_line(data_folder, monkeypatch, tmp_path):
    monkeypatch.setenv("RANK", "1")
    assert "start several processes with torchrun" in failure("train", "--data", data_folder, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


COSTS = """
import torch

def fine(points, info):
    return points["cube"].mean(-2)[..., 2]

def constant(points, info):
    return torch.ones(len(info["action"]))

def mixed(points, info):
    return points["cube"].mean((-2, -1)) - points["cube"].mean()

def shape(points, info):
    return points["cube"].mean(-2)

def missing(points, info):
    return points["mug"].mean((-2, -1))

def nan(points, info):
    return points["cube"].mean((-2, -1)) * float("nan")
"""


@pytest.fixture
def cost_file(tmp_path):
    path = tmp_path / "my_costs.py"
    path.write_text(COSTS)
    return path


@pytest.mark.parametrize("name", ["pick_cube", "pick_cube_plan"])
def test_check_cost_of_a_registered_name(name, capsys):
    main(["check-cost", "--cost", name])
    out = capsys.readouterr().out
    assert f"cost '{name}' is fine on 8 scenes; differentiable" in out
    assert out.count(" to ") >= 5  # a line each term


def test_check_cost_of_a_files_function(cost_file, capsys):
    main(["check-cost", "--cost", f"{cost_file}:fine"])
    out = capsys.readouterr().out
    assert "cost 'fine' is fine on 8 scenes; differentiable" in out
    low, high = (float(x) for x in out.split("fine", 1)[1].splitlines()[0].split("to"))
    assert 0.015 < low <= high < 0.025  # the cubes stand on the table
    main(["check-cost", "--cost", f"{cost_file}:constant"])
    assert "without a gradient here" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("mixed", "cost 'mixed' of a scene depends on its batch"),
        ("shape", "returned (8, 3); expected a tensor (8,)"),
        ("missing", "no entity 'mug'; this scene has hand, left_gripper, right_gripper, cube"),
        ("nan", "returned 8 of 8 values not finite"),
        ("other", "has no function 'other'"),
    ],
)
def test_check_cost_says_what_is_wrong(cost_file, function, message):
    assert message in failure("check-cost", "--cost", f"{cost_file}:{function}")


@pytest.mark.parametrize(("text", "told"), [("raise RuntimeError('no')", "RuntimeError: no"), ("def", "SyntaxError")])
def test_a_cost_whose_file_fails_on_import(tmp_path, text, told):
    (tmp_path / "broken.py").write_text(text)
    assert f"broken.py fails on import: {told}" in failure("check-cost", "--cost", f"{tmp_path}/broken.py:f")


def test_what_cannot_be_written_is_told_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    for option, path in (
        ("--json", tmp_path / "file" / "x.json"),
        ("--json", tmp_path),
        ("--pictures", tmp_path / "file"),
    ):
        assert "cannot be written" in failure("plan", "--task", "NoSuchTask", option, str(path))


def test_check_cost_of_a_missing_file():
    assert "no file 'none.py'; expected a registered cost or 'file.py:function'" in failure(
        "check-cost", "--cost", "none.py:f"
    )


@pytest.fixture
def short_episodes(data_folder, cut, tmp_path):
    """The small data set with test episodes of 12 steps."""
    folder = tmp_path / "short"
    shutil.copytree(data_folder, folder)
    for path in folder.glob("test-*.npz"):
        header = {"format": "pwm_gym.episodes", "schema": 1, "task": "PickCube"}
        write_shard(path, [cut(e, 12) for e in read_shard(path)], header)
    return folder


def test_evaluate_writes_its_table(short_episodes, data_folder, tmp_path, capsys):
    args = f"evaluate --data {short_episodes} --no-floors --threads 1 --completer hull --json {tmp_path}/table.json"
    args += f" --strips {tmp_path}/strips --fit-data {data_folder}"
    main(args.split())
    results = json.loads((tmp_path / "table.json").read_text())
    completed = {f"completed, {view}" for view in ("right", "left", "front")}
    assert {"still", "commanded", "linear", "oracle effector"} | completed < set(results["rows"])
    truth = results["rows"]["compact"]["practice"]["chamfer_l1"]
    assert all(results["rows"][row]["practice"]["chamfer_l1"] > truth for row in completed)
    assert results["rows"]["still"]["practice"]["episodes"] == 1
    assert results["long_rollouts"]["finite"] in (True, False)
    assert results["objects"] == ["cube"] and results["fitted_on"] == str(data_folder)
    out = capsys.readouterr().out
    assert "PickCube, practice: 1 test episodes" in out and "ceiling" in out and "cube: mean error" in out
    with Image.open(tmp_path / "strips" / "PickCube.png") as strips:
        assert strips.width > 500 and strips.height > 250


def test_a_model_of_partial_clouds_starts_from_what_a_camera_sees(short_episodes, tmp_path, capsys):
    train = f"train --data {short_episodes} --out {tmp_path}/run --model particleformer --view partial --loss hybrid"
    main([*train.split(), "--phases", "1", "2", "4", "--arm-steps", "1", "--threads", "1", "--settings", "width", "16"])
    args = f"evaluate --data {short_episodes} --checkpoint {tmp_path}/run/checkpoint --threads 1 --every 4"
    main([*args.split(), "--json", str(tmp_path / "partial.json")])
    results = json.loads((tmp_path / "partial.json").read_text())
    assert results["view"] == "partial" and list(results["rows"]) == ["particleformer", "still", "commanded", "linear"]
    assert results["rows"]["particleformer"]["practice"]["chamfer_l1"] > 0.001
    assert "particleformer" in capsys.readouterr().out
    assert "--completer hull; a model of partial clouds is measured in rollouts alone" in failure(
        *args.split(), "--completer", "hull"
    )


def test_plan_writes_its_table(tmp_path, capsys):
    args = "plan --episodes 1 --max-steps 3 --threads 1 --samples 8 --horizon 2"
    main([*args.split(), "--json", str(tmp_path / "plan.json")])
    results = json.loads((tmp_path / "plan.json").read_text())
    assert results["episodes"] == 1 and results["runs"][0]["steps"] == 3
    assert results["settings"]["samples"] == 8 and results["settings"]["elites"] == 3
    assert "closed loop in the simulator" in capsys.readouterr().out


def test_a_saved_run_is_drawn(tmp_path, capsys):
    args = "plan --episodes 1 --max-steps 3 --threads 1 --planner icem --samples 8 --horizon 2 --chunk 2 --caution 0.1"
    main([*args.split(), "--clear-of", "cube", "--save", str(tmp_path / "runs")])
    (saved,) = (tmp_path / "runs").glob("*.npz")
    run = Run.load(saved)
    assert run.steps == 3 and run.chunk == 2 and run.settings["planner"] == "CEM" and "clear" in run.terms
    for extra in ([], ["--rollout"]):
        main(["view", str(saved), "--out", str(tmp_path / "view"), *extra])
        assert {p.name for p in (tmp_path / "view").iterdir()} == {f"{saved.stem}.png", f"{saved.stem}.gif"}
    main(["view", str(saved), "--out", str(tmp_path / "view"), "--strip"])
    assert (tmp_path / "view" / f"{saved.stem}-strip.png").exists()
    assert "failure after 3 steps; the model looks every 2 steps" in capsys.readouterr().out
    arrays = ("actions", "rewards", "plan_seconds", "predicted", "predicted_rewards", "solved")
    empty = {name: getattr(run, name)[:0] for name in arrays}
    replace(run, **empty, poses=run.poses[:1], terms={}, predicted_terms={}).save(tmp_path / "empty.npz")
    for extra in ([], ["--rollout"], ["--html", str(tmp_path / "empty.html")]):
        assert "empty.npz holds no action" in failure("view", str(tmp_path / "empty.npz"), *extra)
    written = saved.stat().st_mtime_ns
    pictures = ["--pictures", str(tmp_path / "view"), "--json", str(tmp_path / "again.json")]
    main([*args.split(), "--clear-of", "cube", "--save", str(tmp_path / "runs"), *pictures])
    assert saved.stat().st_mtime_ns == written  # what is there is not planned again
    picture = json.loads((tmp_path / "again.json").read_text())["picture"]
    assert picture == "failures/pickcube-chunks-of-2.png" and (tmp_path / "view" / picture).exists()
    with pytest.raises(SystemExit, match="holds runs that were planned with {'caution': 0.1.*expected {'caution': 0.0"):
        main([*args.replace("0.1", "0.0").split(), "--clear-of", "cube", "--save", str(tmp_path / "runs")])


def test_a_workspace_that_is_no_box_is_a_clear_error():
    with pytest.raises(SystemExit, match="low below high"):
        main(["plan", "--episodes", "1", "--threads", "1", "--workspace", "0", "0", "0", "1", "1", "0"])


@pytest.mark.slow
def test_demo_draws_both_worlds(tmp_path, capsys):
    main(["demo", "--episodes", "1", "--threads", "1", "--out", str(tmp_path)])
    assert {p.name for p in tmp_path.iterdir()} == {"twin.png", "twin.gif"}
    assert "Chamfer L1" in capsys.readouterr().out


@pytest.mark.slow
def test_bench_writes_its_results(tmp_path):
    args = "bench --seconds 1 --num-envs 1 4 --samples 4 8 12 --horizons 2 3 --points 300 1200 --planners 1 --threads 1"
    args += " --completer hull --adapter 4"
    main([*args.split(), "--json", str(tmp_path / "bench.json"), "--pictures", str(tmp_path)])
    results = json.loads((tmp_path / "bench.json").read_text())
    assert results["simulator_steps_per_second"] > 0
    assert set(results["model_steps_per_second"]) == {"1", "4"}
    assert set(results["rollout_seconds"]) == {"4 x 2", "8 x 2", "12 x 2", "8 x 3"}
    assert set(results["plan_seconds"]) == {
        "4 x 2 x 1200",
        "8 x 2 x 1200",
        "12 x 2 x 1200",
        "8 x 3 x 1200",
        "8 x 2 x 300",
    }
    assert results["adapter"]["num_envs"] == 4 and results["adapter"]["overhead"] > -1.0
    assert set(results["planners"]) == {"pwm_gym", "pytorch_mppi", "torchrl"}
    assert (tmp_path / "growth.png").exists()
    assert set(results["perception"]["first"]) == {"robot", "segment", "clean", "complete", "all"}
    assert set(results["perception"]["later"]) == {"robot", "segment", "clean", "track", "all"}
    assert 0.0 < results["perception"]["ray-cast"]["all"] < results["start"]["seconds"]
