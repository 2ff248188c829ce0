import json
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pwm_gym.errors import SceneError
from pwm_gym.scene import Layout, Scene, Support, batch_state

LAYOUT = Layout.build([("hand", 20), ("cube", 10)], driven=("hand",))


@pytest.fixture
def scene() -> Scene:
    rng = np.random.default_rng(0)
    poses = np.concatenate([rng.normal(size=(3, 2, 3)), np.zeros((3, 2, 4))], -1)
    poses[..., 3:] = Rotation.random(6, rng=0).as_quat(scalar_first=True).reshape(3, 2, 4)
    return Scene(
        task="PickCube",
        layout=LAYOUT,
        clouds=rng.normal(size=(30, 3)).astype(np.float32),
        poses=poses,
        goal=np.array([0.1, 0.2, 0.3], np.float32),
        joints=rng.normal(size=(2, 9)).astype(np.float32),
        last_action=np.ones(7, np.float32),
    )


def assert_same(a: Scene, b: Scene) -> None:
    for field in fields(Scene):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            assert x.dtype == y.dtype
            np.testing.assert_array_equal(x, y)
        else:
            assert x == y


def test_save_and_load_are_exact(scene, tmp_path):
    scene.save(tmp_path / "scene.npz")
    assert_same(Scene.load(tmp_path / "scene.npz"), scene)


def test_what_a_scene_lacks_stays_lacking(scene, tmp_path):
    bare = replace(scene, joints=None, last_action=None)
    bare.save(tmp_path / "scene.npz")
    assert_same(Scene.load(str(tmp_path / "scene.npz")), bare)


@pytest.mark.parametrize("kept", [0.0, 0.01, 0.3, 0.7, 0.99])
def test_a_truncated_file_is_named(scene, tmp_path, kept):
    path = tmp_path / "scene.npz"
    scene.save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(SceneError, match=r"scene\.npz is not a scene file"):
        Scene.load(path)


def foreign_text(path):
    path.write_text("task: PickCube")


def foreign_array(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


def foreign_archive(path):
    np.savez(path, a=np.zeros(3))


def foreign_pickle(path):
    np.savez(path, header=np.array({"format": "pwm_gym.scene"}, dtype=object))


def headerless(path):
    np.savez(path, header=np.array('{"format": "pwm_gym.scene", "schema": 2}'))


def headless_arrays(path):
    np.savez(path, header=np.array('{"format": "pwm_gym.scene", "schema": 1, "task": "x", "layout": []}'))


@pytest.mark.parametrize("write", [foreign_text, foreign_array, foreign_archive, foreign_pickle, headless_arrays])
def test_a_foreign_file_is_refused(tmp_path, write):
    write(tmp_path / "other.npz")
    with pytest.raises(SceneError, match=r"other\.npz is not a scene file"):
        Scene.load(tmp_path / "other.npz")


def test_another_format_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", header=np.array('{"format": "pwm_gym.episodes"}'))
    with pytest.raises(SceneError, match=r"format 'pwm_gym\.episodes'; expected 'pwm_gym\.scene'"):
        Scene.load(tmp_path / "other.npz")


def test_a_damaged_header_is_named(tmp_path):
    headerless(tmp_path / "other.npz")
    with pytest.raises(SceneError, match=r"header of .*other\.npz .*missing required field `task`"):
        Scene.load(tmp_path / "other.npz")


def test_a_newer_schema_is_refused(scene, tmp_path):
    scene.save(tmp_path / "scene.npz")
    with np.load(tmp_path / "scene.npz") as file:
        arrays = dict(file)
    header = {**json.loads(str(arrays.pop("header"))), "schema": 3}
    np.savez(tmp_path / "new.npz", header=np.array(json.dumps(header)), **arrays)
    with pytest.raises(SceneError, match=r"new\.npz has schema 3; this version reads up to 2"):
        Scene.load(tmp_path / "new.npz")


def test_a_scene_of_version_0_1_loads(scene, tmp_path):
    old = [
        {"name": e.name, "start": e.start, "stop": e.stop, "effector": e.driven, "slider": None} for e in scene.layout
    ]
    header = {"format": "pwm_gym.scene", "schema": 1, "task": scene.task, "layout": old}
    arrays = {name: getattr(scene, name) for name in ("clouds", "poses", "goal", "joints", "last_action")}
    np.savez(tmp_path / "old.npz", header=np.array(json.dumps(header)), **arrays)
    expected = replace(scene, layout=replace(scene.layout, supports=(Support.ground(),)))
    assert_same(Scene.load(tmp_path / "old.npz"), expected)


def test_assets_and_empty_goals_survive(scene, tmp_path):
    other = replace(scene, goal=np.zeros(0, np.float32), assets=("hand", "red cube"))
    other.save(tmp_path / "scene.npz")
    found = Scene.load(tmp_path / "scene.npz")
    assert_same(found, other)
    assert found.validate("PickCube", LAYOUT, 0) is found
    with pytest.raises(SceneError, match="names 1 assets; expected one for each of 2 entities"):
        replace(found, assets=("cube",)).validate("PickCube", LAYOUT, 0)


def test_values_that_are_not_finite_are_not_read(scene, tmp_path):
    replace(scene, clouds=scene.clouds * np.nan).save(tmp_path / "scene.npz")
    with pytest.raises(SceneError, match=r"clouds holds 90 values that are not finite"):
        Scene.load(tmp_path / "scene.npz")


def test_a_missing_file_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        Scene.load(tmp_path / "none.npz")


def test_a_fitting_scene_is_returned(scene):
    assert scene.validate("PickCube", LAYOUT, 3) is scene
    assert scene.validate("PickCube", LAYOUT.resize(9), 3) is scene


def broken(name, index, value):
    def change(scene):
        array = getattr(scene, name).copy()
        array[index] = value
        return replace(scene, **{name: array})

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: replace(s, task="StackCube"), "'StackCube'; expected 'PickCube'"),
        (lambda s: replace(s, layout=Layout.build([("hand", 20), ("mug", 10)])), "entities are .*mug"),
        (lambda s: s.coarsen(LAYOUT.resize(29)), r"point counts are \[19, 10\]; expected at least \[20, 10\]"),
        (lambda s: replace(s, clouds=s.clouds[:-1]), r"scene\.clouds has shape \(29, 3\)"),
        (lambda s: replace(s, poses=s.poses[0]), r"scene\.poses has shape \(2, 7\); expected \(3, 2, 7\)"),
        (lambda s: replace(s, goal=s.goal[:2]), r"scene\.goal has shape \(2,\); expected \(3,\)"),
        (broken("clouds", (3, 1), np.nan), r"scene\.clouds holds 1 values that are not finite"),
        (broken("poses", (0, 0, 0), np.inf), r"scene\.poses holds 1 values"),
        (broken("poses", (1, 1, slice(3, 7)), 0.0), "quaternion of norm 0.000"),
        (broken("poses", (2, 0, slice(3, 7)), 1.0), "quaternion of norm 2.000"),
    ],
)
def test_what_does_not_fit_is_named(scene, change, message):
    with pytest.raises(SceneError, match=message):
        change(scene).validate("PickCube", LAYOUT, 3)


def test_coarsen_keeps_each_entitys_first_points(scene):
    coarse = scene.coarsen(LAYOUT.resize(15))
    np.testing.assert_array_equal(coarse.clouds, np.r_[scene.clouds[:10], scene.clouds[20:25]])
    assert scene.coarsen(LAYOUT) is scene


def test_a_batch_of_scenes_is_a_state(scene):
    moved = replace(scene, poses=scene.poses + np.r_[1.0, np.zeros(6)])
    state = batch_state([scene, moved])
    assert state.batch == (2,)
    turn = Rotation.from_quat(scene.poses[0, 1, 3:], scalar_first=True)
    expected = turn.apply(scene.clouds[20:]) + scene.poses[0, 1, :3]
    np.testing.assert_allclose(state.entity("cube")[0], expected, atol=1e-5)
    np.testing.assert_allclose(state.points()[1] - state.points()[0], np.tile([1.0, 0, 0], (30, 1)), atol=1e-5)
    np.testing.assert_allclose(state.velocity()[1], state.velocity()[0], atol=1e-5)
