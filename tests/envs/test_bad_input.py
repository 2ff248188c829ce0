"""Bad input gives one clear error that names the value and what was expected."""

import json
import shutil
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

import pwm_gym
from pwm_gym.dynamics.checkpoint import SCHEMA, resolve, shipped
from pwm_gym.errors import CheckpointError, PwmGymError, SceneError, UnknownNameError
from pwm_gym.scene import Layout

ID, SIM = "pwm/PickCube-v0", "pwm/PickCubeSim-v0"


@pytest.fixture(params=["model", "sim"])
def either(request):
    """Both twins, ready to step."""
    env = request.getfixturevalue("env" if request.param == "model" else "sim")
    env.reset(seed=0)
    return env.unwrapped


ACTIONS = [
    (np.zeros(6, np.float32), r"actions have shape \(6,\); expected \(7,\)"),
    (np.zeros((1, 7), np.float32), r"actions have shape \(1, 7\); expected \(7,\)"),
    (np.float32(0), r"actions have shape \(\); expected \(7,\)"),
    (np.zeros(7, np.int64), "actions have dtype int64; expected floating point"),
    (torch.zeros(7, dtype=torch.int32), "actions have dtype torch.int32; expected floating point"),
    (["a"] * 7, "actions have dtype <U1; expected floating point"),
    (np.full(7, np.nan, np.float32), "actions hold 7 values that are not finite"),
    (np.array([np.inf, 0, 0, 0, 0, 0, 0]), "actions hold 1 values that are not finite"),
    (np.array([0, -1.5, 0, 0, 0, 0, 0]), r"actions hold -1.5; expected values in \[-1, 1\]"),
]


@pytest.mark.parametrize(("action", "message"), ACTIONS)
def test_actions(either, action, message):
    with pytest.raises(PwmGymError, match=message):
        either.step(action)


def test_a_refused_action_changes_nothing(either):
    before = either.state.points()
    with pytest.raises(PwmGymError):
        either.step(np.full(7, np.nan))
    assert torch.equal(either.state.points(), before)


def test_batched_actions():
    env = gym.make_vec(ID, num_envs=3)
    env.reset(seed=0)
    with pytest.raises(PwmGymError, match=r"actions have shape \(2, 7\); expected \(3, 7\)"):
        env.step(np.zeros((2, 7), np.float32))


def poses_with(scene, value):
    poses = scene.poses.copy()
    poses[0, 0, 0] = value
    return poses


SCENES = {
    "task": (lambda s: replace(s, task="Juggle"), "of task 'Juggle'; expected 'PickCube'"),
    "entities": (
        lambda s: replace(s, layout=Layout.build([("hand", 300), ("cube", 300)])),
        r"entities are \('hand', 'cube'\); expected \('hand', 'left_gripper', 'right_gripper', 'cube'\)",
    ),
    "points": (
        lambda s: s.coarsen(s.layout.resize(600)),
        r"point counts are \[150, 150, 150, 150\]; expected at least \[300, 300, 300, 300\]",
    ),
    "cloud shape": (
        lambda s: replace(s, clouds=s.clouds[:-1]),
        r"scene.clouds has shape \(1199, 3\); expected \(1200, 3\)",
    ),
    "pose shape": (
        lambda s: replace(s, poses=s.poses[0]),
        r"scene.poses has shape \(4, 7\); expected \(3, 4, 7\)",
    ),
    "goal shape": (lambda s: replace(s, goal=s.goal[:2]), r"scene.goal has shape \(2,\); expected \(3,\)"),
    "NaN cloud": (
        lambda s: replace(s, clouds=np.full_like(s.clouds, np.nan)),
        "scene.clouds holds 3600 values that are not finite",
    ),
    "NaN pose": (
        lambda s: replace(s, poses=poses_with(s, np.nan)),
        "scene.poses holds 1 values that are not finite",
    ),
    "quaternion": (lambda s: replace(s, poses=s.poses * 2), r"quaternion of norm 2\.000"),
    "short last action": (
        lambda s: replace(s, last_action=np.zeros(3, np.float32)),
        r"scene.last_action: actions have shape \(3,\); expected \(7,\)",
    ),
    "NaN last action": (
        lambda s: replace(s, last_action=np.full(7, np.nan, np.float32)),
        "scene.last_action: actions hold 7 values that are not finite",
    ),
}


@pytest.mark.parametrize("case", SCENES)
def test_scenes(either, case):
    change, message = SCENES[case]
    scene = either.scene()
    before = either.state.points()
    with pytest.raises(SceneError, match=message):
        either.reset(options={"scene": change(scene)})
    assert torch.equal(either.state.points(), before)


@pytest.mark.parametrize(("scene", "kind"), [(5, "int"), ({"points": 1}, "dict"), ("scene.npz", "str")])
def test_scenes_of_another_type(either, scene, kind):
    with pytest.raises(PwmGymError, match=f"scene is a {kind}; expected pwm_gym.Scene"):
        either.reset(options={"scene": scene})


def test_reset_options(either):
    with pytest.raises(UnknownNameError, match=r"unknown reset option 'scenes'; known: .*Did you mean 'scene'\?"):
        either.reset(options={"scenes": None})


# Scene files


def truncated(path, scene):
    scene.save(path)
    path.write_bytes(path.read_bytes()[:2000])


def foreign(path, scene):
    np.savez(path, header=np.array(json.dumps({"format": "somebody.else"})))


def nameless(path, scene):
    np.savez(path, points=np.zeros(3))


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (truncated, "is not a scene file"),
        (foreign, "has format 'somebody.else'; expected 'pwm_gym.scene'"),
        (nameless, "is not a scene file"),
        (lambda path, scene: path.write_text("hello"), "is not a scene file"),
        (lambda path, scene: path.write_bytes(b""), "is not a scene file"),
    ],
    ids=["truncated", "foreign", "nameless", "text", "empty"],
)
def test_scene_files(scene, tmp_path, write, message):
    write(tmp_path / "scene.npz", scene)
    with pytest.raises(SceneError, match=message):
        pwm_gym.Scene.load(tmp_path / "scene.npz")


# Names


@pytest.mark.parametrize("name", [ID, SIM])
def test_unknown_arguments(name):
    with pytest.raises(TypeError, match="colour"):
        gym.make(name, colour="red")


@pytest.mark.parametrize("name", [ID, SIM])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"cost": "pick_cub"},
            r"unknown cost 'pick_cub'; known: .*pick_cube_plan.*Did you mean 'pick_cube'\?",
        ),
        ({"grasp": "pik_cube"}, r"unknown grasp rule 'pik_cube'; known: .*Did you mean 'pick_cube'\?"),
        ({"task": "PickCub"}, r"unknown task 'PickCub'; known: .*Did you mean 'PickCube'\?"),
    ],
)
def test_unknown_names(name, arguments, message):
    with pytest.raises(UnknownNameError, match=message):
        gym.make(name, **arguments)


def test_unknown_checkpoint():
    known = ", ".join(sorted(["default", *shipped()]))
    message = rf"unknown checkpoint 'pand'; known: {known}\. Did you mean 'panda'\?"
    with pytest.raises(UnknownNameError, match=message):
        gym.make(ID, checkpoint="pand")


def test_unknown_observation():
    message = r"unknown observation 'complet'; known: .*Did you mean 'complete'\?"
    with pytest.raises(UnknownNameError, match=message):
        gym.make(SIM, observation="complet")


@pytest.mark.parametrize("cls", [pwm_gym.envs.ModelEnv, pwm_gym.envs.ModelVectorEnv, pwm_gym.envs.SimEnv])
def test_unknown_render_mode(cls):
    message = r"unknown render mode 'rgb_aray'; known: rgb_array. Did you mean 'rgb_array'\?"
    with pytest.raises(UnknownNameError, match=message):
        cls(render_mode="rgb_aray")


@pytest.mark.parametrize("name", [ID, SIM])
@pytest.mark.parametrize("points", [3, 1201])
def test_point_counts(name, points):
    with pytest.raises(PwmGymError, match=f"points={points}; expected a whole number from 4 to 1200"):
        gym.make(name, points=points)


def test_number_of_environments():
    with pytest.raises(PwmGymError, match="num_envs=0; expected a whole number of at least 1"):
        gym.make_vec(ID, num_envs=0)


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
def test_cuda_without_a_gpu():
    with pytest.raises(CheckpointError, match=r"device='cuda'.*sees no CUDA device; use 'cpu'"):
        gym.make(ID, device="cuda")


@pytest.mark.parametrize("device", ["foo", 3.5, None])
def test_devices_that_are_none(device):
    with pytest.raises(CheckpointError, match=f"device={device!r}; expected a PyTorch device"):
        gym.make(ID, device=device)


def test_state_before_the_first_reset():
    with pytest.raises(PwmGymError, match=r"no state yet; call reset\(\) first"):
        gym.make_vec(ID, num_envs=1).step(np.zeros((1, 7), np.float32))


# Checkpoints


@pytest.fixture
def checkpoint(tmp_path):
    """A copy to damage."""
    return shutil.copytree(resolve("default", "PickCube"), tmp_path / "checkpoint")


def edited(folder, **changes):
    path = folder / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


CHECKPOINTS = {
    "newer schema": (
        lambda f: edited(f, schema=SCHEMA + 1),
        f"config.json has schema {SCHEMA + 1}; this version reads up to {SCHEMA}",
    ),
    "foreign": (
        lambda f: edited(f, format="somebody.else"),
        "config.json has format 'somebody.else'; expected 'pwm_gym.checkpoint'",
    ),
    "version 0.1": (lambda f: edited(f, schema=1), "is of version 0.1, whose weights do not fit; train it again"),
    "no config": (lambda f: (f / "config.json").unlink(), "not a checkpoint: it has no config.json"),
    "cut config": (lambda f: cut(f / "config.json"), "config.json is truncated or not valid"),
    "cut weights": (
        lambda f: cut(f / "model.safetensors"),
        "model.safetensors is truncated or not safetensors",
    ),
    "no weights": (lambda f: (f / "model.safetensors").unlink(), "not a checkpoint: it has no model.safetensors"),
    "other weights": (
        lambda f: edited(f, model="paper", config={}),
        "model.safetensors does not fit its config.json",
    ),
    "cut scenes": (lambda f: cut(f / "scenes-PickCube.npz"), "scenes-PickCube.npz is truncated or not a scene bank"),
    "setting": (lambda f: edited(f, config={"widht": 1}), "unknown compact setting 'widht'"),
}


@pytest.mark.parametrize("case", CHECKPOINTS)
def test_checkpoints(checkpoint, case):
    damage, message = CHECKPOINTS[case]
    gym.make(ID, checkpoint=str(checkpoint))
    damage(checkpoint)
    with pytest.raises(CheckpointError, match=message):
        gym.make(ID, checkpoint=str(checkpoint))


def test_a_checkpoint_without_scenes_of_the_task_starts_from_given_ones(checkpoint, scene):
    (checkpoint / "scenes-PickCube.npz").unlink()
    env = gym.make(ID, checkpoint=str(checkpoint))
    with pytest.raises(CheckpointError, match="has scenes of PickYCB, StackCube; expected 'PickCube'"):
        env.reset(seed=0)
    env.reset(options={"scene": scene})


def test_a_checkpoint_of_another_robot(checkpoint):
    config = json.loads((checkpoint / "config.json").read_text())
    for link in config["links"]["entities"]:
        link["name"] = f"other_{link['name']}"
        if link["joint"]["parent"]:
            link["joint"]["parent"] = f"other_{link['joint']['parent']}"
    config["control"]["arms"][0]["hand"] = "other_hand"
    edited(checkpoint, **config)
    with pytest.raises(CheckpointError, match="is of a robot with other_hand, .*; expected hand, "):
        gym.make(ID, checkpoint=str(checkpoint))


# Costs


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (
            lambda points, info: points["cube"].mean(-2),
            r"cost '<lambda>' .*returned \(1, 3\); expected a tensor \(1,\)",
        ),
        (lambda points, info: 1.0, r"returned float; expected a tensor \(1,\)"),
        (lambda points, info: points["cube"].mean(), r"returned \(\); expected a tensor \(1,\)"),
        (lambda points, info: info["goal"].sum(-1) * torch.nan, "returned 1 of 1 values not finite"),
        (
            lambda points, info: points["mug"].mean((-1, -2)),
            "no entity 'mug'; this scene has hand, left_gripper, right_gripper, cube",
        ),
    ],
    ids=["shape", "float", "scalar", "NaN", "entity"],
)
@pytest.mark.parametrize("name", [ID, SIM])
def test_costs(name, cost, message):
    env = gym.make(name, cost=cost)
    with pytest.raises(PwmGymError, match=message):
        env.reset(seed=0)
    env.close()


def test_a_cost_names_how_many_of_a_batch_fail():
    def half(points, info):
        return torch.where(torch.arange(4) < 2, torch.nan, 0.0)

    env = gym.make_vec(ID, num_envs=4, cost=half)
    with pytest.raises(PwmGymError, match=r"cost 'half' .*returned 2 of 4 values not finite"):
        env.reset(seed=0)


def test_a_cost_name_is_taken_once(costs):
    with pytest.raises(ValueError, match="cost 'pick_cube' is registered already"):
        pwm_gym.register_cost("pick_cube")(lambda points, info: None)
