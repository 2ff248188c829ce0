import os
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint

import gymnasium as gym
import pytest

import pwm_gym
from pwm_gym import registration
from pwm_gym.costs import COSTS, GRASPS, SUCCESSES, get_cost
from pwm_gym.errors import UnknownNameError
from pwm_gym.tasks import TASKS, Task, get_task, register_task

THIRD_PARTY = replace(get_task("PickCube"), name="ThirdParty", max_episode_steps=7)
IDS = ["pwm/ThirdParty-v0", "pwm/ThirdPartySim-v0"]


@pytest.fixture
def clean():
    """Tasks registered by the test are forgotten after it."""
    tasks, loaded = dict(TASKS), set(registration._LOADED)
    yield
    for name in TASKS.keys() - tasks.keys():
        del TASKS[name]
        for kind in ("", "Sim"):
            gym.registry.pop(f"pwm/{name}{kind}-v0", None)
    registration._LOADED.clear()
    registration._LOADED.update(loaded)


@pytest.fixture
def plugins(monkeypatch):
    """``plugins(value, ...)``: installed packages have these entry points, for tasks or for another group."""

    def install(*values, group=registration.ENTRY_POINTS):
        points = [EntryPoint(f"plugin{k}", value, group) for k, value in enumerate(values)]
        monkeypatch.setattr(registration, "entry_points", lambda group: [p for p in points if p.group == group])

    return install


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_a_tasks_parts_fit_together(task):
    assert len(task.robot.action_names) == task.action_size
    assert not any(task.layout[name].driven for name in task.objects)
    assert task.layout.names[: len(task.robot.links)] == task.robot.driven
    assert {task.cost, task.plan_cost} <= set(COSTS)
    assert task.success in SUCCESSES and task.grasp in GRASPS
    assert all(hand.joint.kind == "free" for hand in (task.layout[arm.hand] for arm in task.control.arms))
    assert task.description and task.max_episode_steps > 0


def test_the_papers_point_counts():
    assert get_task("PickCube").layout.points == 1200
    assert get_task("StackCube").layout.points == 1500


def test_an_unknown_task_is_answered_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"unknown task 'PickCub'; known: .*Did you mean 'PickCube'\?"):
        get_task("PickCub")


def test_a_name_is_taken_once():
    with pytest.raises(ValueError, match="'PickCube' is registered already"):
        register_task(get_task("PickCube"))


def test_a_registered_task_has_its_environments_at_once(clean):
    assert not set(IDS) & set(gym.registry)
    assert pwm_gym.register_task(THIRD_PARTY) is THIRD_PARTY
    assert [gym.spec(i).max_episode_steps for i in IDS] == [7, 7]
    assert gym.spec(IDS[0]).kwargs == {"task": "ThirdParty"}
    assert get_task("ThirdParty") is THIRD_PARTY


def test_commands_list_a_registered_task(clean, capsys):
    from pwm_gym.cli import main

    register_task(THIRD_PARTY)
    main(["envs"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in IDS)


def provide():
    """What an entry point may name: a function that registers."""
    register_task(THIRD_PARTY)


@pytest.mark.parametrize("found", [THIRD_PARTY, provide], ids=["task", "function"])
def test_an_entry_point_brings_its_task(clean, plugins, monkeypatch, found):
    monkeypatch.setattr(pwm_gym.tasks, "from_plugin", found, raising=False)
    plugins("pwm_gym.tasks:from_plugin")
    pwm_gym.register_envs()
    assert set(IDS) <= set(gym.registry)
    pwm_gym.register_envs()  # which is harmless
    assert isinstance(TASKS["ThirdParty"], Task)


def test_a_broken_entry_point_is_left_out_with_a_warning(clean, plugins, monkeypatch):
    monkeypatch.setattr(pwm_gym.tasks, "from_plugin", THIRD_PARTY, raising=False)
    plugins("no_such_package:TASK", "pwm_gym.tasks:from_plugin")
    with pytest.warns(UserWarning, match=r"'plugin0' \(no_such_package:TASK\) are left out: No module named"):
        pwm_gym.register_envs()
    assert set(IDS) <= set(gym.registry)


def height(points, info):
    """A plug-in's cost."""
    return points["cube"][..., 2].mean(-1)


def test_an_entry_point_brings_its_cost(clean, costs, plugins, monkeypatch):
    monkeypatch.setattr(pwm_gym.tasks, "from_plugin", height, raising=False)
    plugins("pwm_gym.tasks:from_plugin", group=registration.COST_ENTRY_POINTS)
    pwm_gym.register_envs()
    pwm_gym.register_envs()  # which is harmless
    assert costs["plugin0"].terms == {"plugin0": (1.0, height)}
    assert get_cost("0.5 * plugin0 + pick_cube").name == "0.5 * plugin0 + pick_cube"


@pytest.mark.parametrize(
    ("found", "message"), [(3, "it names 3; expected a cost function or a module"), (None, "it names None")]
)
def test_an_entry_point_that_is_no_cost_is_left_out_with_a_warning(clean, costs, plugins, monkeypatch, found, message):
    monkeypatch.setattr(pwm_gym.tasks, "from_plugin", found, raising=False)
    plugins("pwm_gym.tasks:from_plugin", group=registration.COST_ENTRY_POINTS)
    before = dict(costs)
    with pytest.warns(UserWarning, match=rf"costs of entry point 'plugin0' .* are left out: {message}"):
        pwm_gym.register_envs()
    assert costs == before


def test_an_installed_packages_task_is_there_in_a_fresh_process(tmp_path):
    """Its module imports the package that is just loading it."""
    (tmp_path / "my_task.py").write_text(
        "from dataclasses import replace\n"
        "import pwm_gym\n"
        "from pwm_gym.tasks import get_task\n"
        "TASK = pwm_gym.register_task(replace(get_task('PickCube'), name='Installed'))\n"
    )
    info = tmp_path / "my_task-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-task\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[pwm_gym.tasks]\nmine = my_task:TASK\n")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    code = (
        "import warnings; warnings.simplefilter('error')\nimport pwm_gym\nfrom pwm_gym.cli import main\nmain(['envs'])"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": path}
    )
    assert "pwm/Installed-v0" in out.stdout and "pwm/InstalledSim-v0" in out.stdout
