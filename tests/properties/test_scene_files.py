"""Scenes in files: what was saved is read, and a damaged file is an error or the same scene."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Joint, Layout, Scene, Support
from pwm_gym.scene.joint import IDENTITY
from pwm_gym.scene.poses import compose

names = st.text(min_size=1, max_size=8)
numbers = st.floats(-10, 10)


@st.composite
def joints(draw, parents):
    kind = draw(st.sampled_from(["free", "fixed", "prismatic", "revolute"]))
    parent = None if kind == "free" else draw(st.sampled_from([None, *parents]))
    lower = draw(numbers)
    return Joint(kind, parent, lower=lower, upper=lower + draw(st.floats(0, 3)))


@st.composite
def layouts(draw):
    called = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    counts = [(name, draw(st.integers(1, 5))) for name in called]
    hanging = {name: draw(joints(called[:k])) for k, name in enumerate(called)}
    driven = [name for name in called if draw(st.booleans())]
    supports = [Support.ground(draw(numbers)) for _ in range(draw(st.integers(0, 2)))]
    return Layout.build(counts, driven, hanging, supports)


def on_joint(joint, parent, rng):
    """A pose (7,) somewhere along a joint."""
    position, axis = rng.uniform(joint.lower, joint.upper), np.array(joint.axis)
    turn = Rotation.from_rotvec(position * axis).as_quat(scalar_first=True)
    moved = np.r_[position * axis, 1.0, 0.0, 0.0, 0.0] if joint.kind == "prismatic" else np.r_[0.0, 0.0, 0.0, turn]
    return compose(parent, compose(np.array(joint.origin), moved))


@st.composite
def scenes(draw):
    layout, rng = draw(layouts()), np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    quaternions = rng.normal(size=(3, len(layout), 4))
    poses = np.concatenate([rng.normal(size=(3, len(layout), 3)), quaternions], -1)
    poses[..., 3:] /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    for k, entity in enumerate(layout):
        if entity.joint.moves:
            parent = entity.joint.parent
            bases = [IDENTITY] * 3 if parent is None else poses[:, layout.index(parent)]
            poses[:, k] = [on_joint(entity.joint, np.array(base), rng) for base in bases]
    joints = rng.normal(size=(2, draw(st.integers(1, 9)))) if draw(st.booleans()) else None
    return Scene(
        task=draw(names),
        layout=layout,
        clouds=rng.normal(size=(layout.points, 3)).astype(np.float32),
        poses=poses,
        goal=rng.normal(size=draw(st.integers(0, 4))),
        joints=joints,
        last_action=rng.uniform(-1, 1, 7) if draw(st.booleans()) else None,
        assets=tuple(draw(names) for _ in layout) if draw(st.booleans()) else (),
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("scenes") / "scene.npz"


def same(one, other):
    for part in fields(Scene):
        np.testing.assert_equal(getattr(one, part.name), getattr(other, part.name))


@given(scene=scenes())
def test_a_scene_survives_its_file(path, scene):
    scene.save(path)
    again = Scene.load(path)
    same(again, scene)
    again.validate(scene.task, scene.layout, len(scene.goal))


@given(layout=layouts())
def test_a_layout_survives_its_json(layout):
    assert Layout.from_json(layout.to_json()) == layout


@given(scene=scenes(), place=st.floats(0, 1, exclude_max=True), change=st.integers(1, 255))
def test_a_scene_with_any_wrong_byte_is_an_error_or_the_same(path, scene, place, change):
    scene.save(path)
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= change
    path.write_bytes(content)
    try:
        again = Scene.load(path)
    except PwmGymError as error:
        assert str(error)
    else:
        same(again, scene)


@given(scene=scenes(), share=st.floats(0, 1, exclude_max=True))
def test_a_scene_without_its_end_is_an_error(path, scene, share):
    scene.save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(PwmGymError, match="is not a scene file"):
        Scene.load(path)
