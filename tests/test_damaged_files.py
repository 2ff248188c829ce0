"""Whatever happens to a file, reading it ends in one of the package's own errors."""

import copy
import io
import json
import random
import shutil

import numpy as np
import pytest
import torch

from pwm_gym.cameras import DepthCamera
from pwm_gym.data import Episode
from pwm_gym.data.episodes import read_shard, write_shard
from pwm_gym.dynamics import SceneBank, build_model, load_checkpoint, save_checkpoint
from pwm_gym.errors import PwmGymError
from pwm_gym.perception import Frame
from pwm_gym.planning import Run
from pwm_gym.scene import Layout, Scene
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")
LAYOUT = TASK.layout.truncate(6)
ENTITIES = len(LAYOUT)
RNG = np.random.default_rng(0)
ROUNDS = 60  # of each kind of file
SWAPS = (None, True, -1, 10**30, 0.5, "", "a", "\ud800", [], {}, [[]], {"a": [1]}, "x" * 1000)
"""What a value may become; none is a size that would be allocated."""


def poses(*shape):
    quaternion = RNG.normal(size=(*shape, ENTITIES, 4))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.concatenate([RNG.normal(size=(*shape, ENTITIES, 3)), quaternion], -1)


def make_scene():
    clouds = RNG.normal(size=(LAYOUT.points, 3)).astype(np.float32)
    return Scene("PickCube", LAYOUT, clouds, poses(3), np.zeros(3, np.float32), np.zeros((2, 9), np.float32))


def make_shard(path):
    episode = Episode(
        poses=poses(4).astype(np.float32),
        joints=np.zeros((4, 2, 9), np.float32),
        actions=np.zeros((3, 7), np.float32),
        rewards=np.zeros(3, np.float32),
        success=np.zeros(3, bool),
        grasped=np.zeros(3, bool),
        goal=np.zeros(3, np.float32),
        kind=0,
        seed=1,
        assets=LAYOUT.names,
    )
    write_shard(path, [episode, episode], {"format": "pwm_gym.episodes", "schema": 1, "task": "PickCube"})


def make_run(path):
    Run(
        start=make_scene(),
        seed=0,
        success=True,
        actions=np.zeros((2, 7), np.float32),
        rewards=np.zeros(2),
        plan_seconds=np.zeros(2),
        poses=poses(3),
        predicted=poses(2),
        predicted_rewards=np.zeros(2),
        terms={"reach": np.zeros(2)},
        predicted_terms={"reach": np.ones(2)},
        settings={"cost": "pick_cube"},
    ).save(path)


def make_frame(path):
    camera = DepthCamera(np.array([[5.0, 0, 4], [0, 5, 3], [0, 0, 1]]), np.eye(4), 8, 6)
    depth, mask = np.full((6, 8), 0.7, np.float32), np.zeros((6, 8), bool)
    Frame(np.zeros((6, 8, 3), np.uint8), depth, camera, joints=np.zeros(9), masks={"cube": mask}).save(path)


FILES = {
    "scene": (lambda p: make_scene().save(p), lambda p: Scene.load(p).validate("PickCube", LAYOUT, 3)),
    "shard": (make_shard, lambda p: read_shard(p, "PickCube")),
    "run": (make_run, Run.load),
    "frame": (make_frame, Frame.load),
}


def damage_bytes(content, chance):
    """A few bits flipped, or the end cut off, or a part doubled."""
    how = chance.randrange(3)
    if how == 0:
        return content[: chance.randrange(len(content))]
    if how == 1:
        at = chance.randrange(len(content))
        return content[:at] + content[at // 2 : at] + content[at:]
    damaged = bytearray(content)
    for _ in range(chance.randrange(1, 6)):
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def places(value, path=()):
    """Paths of all values in JSON."""
    yield path
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from places(child, (*path, key))


def damage_json(value, chance):
    """One value swapped for another one, or gone."""
    value = copy.deepcopy(value)
    path = chance.choice([p for p in places(value) if p])
    parent = value
    for key in path[:-1]:
        parent = parent[key]
    if isinstance(parent, dict) and chance.random() < 0.3:
        del parent[path[-1]]
    else:
        parent[path[-1]] = chance.choice(SWAPS)
    return value


def damage_array(array, chance):
    """An array of another shape, type or content."""
    ways = (
        lambda: array[..., None],
        lambda: array.reshape(-1)[:1],
        lambda: np.empty(0),
        lambda: np.array(3.5),
        lambda: np.array("text"),
        lambda: array.astype(complex),
        lambda: np.full(array.shape, np.nan),
        lambda: array.astype(str),
        lambda: -np.ones_like(array, dtype=np.int64) * 2**62,
        lambda: np.concatenate([array, array]) if array.ndim else array,
    )
    return chance.choice(ways)()


def damage_npz(content, chance):
    """Its bytes, its header or one of its arrays damaged."""
    how = chance.randrange(3)
    if how == 0:
        return damage_bytes(content, chance)
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    if how == 1 and "header" in arrays:
        header = json.dumps(damage_json(json.loads(str(arrays["header"])), chance))
        if chance.random() < 0.3:
            header = damage_bytes(header.encode(), chance).decode("utf-8", "replace")
        arrays["header"] = np.array(header)
    else:
        name = chance.choice([n for n in arrays if n != "header"])
        if chance.random() < 0.2:
            del arrays[name]
        else:
            arrays[name] = damage_array(arrays[name], chance)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def damage_config(content, chance):
    if chance.random() < 0.4:
        return damage_bytes(content, chance)
    return json.dumps(damage_json(json.loads(content), chance)).encode()


def check(read, path, content, tell):
    """Reading it succeeds or ends in an error of the package."""
    path.write_bytes(content)
    try:
        read()
    except PwmGymError as error:
        assert str(error)
        return True
    except FileNotFoundError:
        return True
    except Exception as error:
        raise AssertionError(f"{tell}: {type(error).__name__}: {error}") from error
    return False


@pytest.mark.parametrize("kind", FILES)
def test_damaged_arrays_end_in_a_clear_error(kind, tmp_path):
    write, read = FILES[kind]
    path = tmp_path / "file.npz"
    write(path)
    read(path)
    whole = path.read_bytes()
    refused = 0
    for number in range(ROUNDS):
        chance = random.Random(f"{kind} {number}")
        refused += check(lambda: read(path), path, damage_npz(whole, chance), f"{kind}, damage {number}")
    assert refused > ROUNDS // 2


@pytest.mark.parametrize("name", ["config.json", "model.safetensors", "scenes-PickCube.npz"])
def test_a_damaged_checkpoint_ends_in_a_clear_error(name, tmp_path):
    folder = tmp_path / "checkpoint"
    scene, model = make_scene(), build_model("linear", LAYOUT, TASK.control)
    bank = SceneBank(
        "PickCube",
        LAYOUT,
        scene.clouds[None],
        scene.poses.astype(np.float32),
        np.zeros((3, 3), np.float32),
        np.zeros(3, int),
    )
    torch.manual_seed(0)
    save_checkpoint(folder, model, "linear", [bank], {"data": {}}, {})
    load_checkpoint(folder)
    path = folder / name
    whole, damage = path.read_bytes(), damage_npz if name.endswith("npz") else damage_bytes
    if name == "config.json":
        damage = damage_config
    refused = 0
    for number in range(ROUNDS):
        chance = random.Random(f"{name} {number}")
        tell = f"{name}, damage {number}"
        refused += check(lambda: load_checkpoint(folder), path, damage(whole, chance), tell)
    assert refused > ROUNDS // 8


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\xff" * 64, b"[" * 100_000], ids=["empty", "zip", "ones", "deep"]
)
def test_other_files_end_in_a_clear_error(kind, content, tmp_path):
    path = tmp_path / "file.npz"
    assert check(lambda: FILES[kind][1](path), path, content, kind)


@pytest.mark.parametrize("kind", FILES)
def test_a_folder_in_a_files_place_ends_in_a_clear_error(kind, tmp_path):
    path = tmp_path / "file.npz"
    path.mkdir()
    with pytest.raises(PwmGymError, match="file"):
        FILES[kind][1](path)
    shutil.rmtree(path)
    with pytest.raises((PwmGymError, FileNotFoundError), match="file"):
        FILES[kind][1](path)


def test_layouts_of_any_json_end_in_a_clear_error():
    whole = json.loads(json.dumps(LAYOUT.to_json()))
    for number in range(5 * ROUNDS):
        chance = random.Random(number)
        try:
            Layout.from_json(damage_json(whole, chance))
        except PwmGymError:
            continue
        except Exception as error:
            raise AssertionError(f"damage {number}: {type(error).__name__}: {error}") from error
