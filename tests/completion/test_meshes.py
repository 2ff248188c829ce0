import warnings

import numpy as np
import pytest
import trimesh

from pwm_gym.completion.meshes import load_meshes, normalise
from pwm_gym.errors import PwmGymError, UnknownNameError

BOX = trimesh.creation.box([0.3, 0.1, 0.2], transform=trimesh.transformations.translation_matrix([1, 2, 3]))
BALL = trimesh.creation.icosphere(2, 0.05)
OPEN = trimesh.Trimesh(BOX.vertices, BOX.faces[:-1])


def write_archive(path, **arrays):
    np.savez(path, **{key.replace("__", "/"): value for key, value in arrays.items()})
    return path


def archive_of(path, **meshes):
    parts = {"v": lambda m: m.vertices.astype(np.float32), "f": lambda m: m.faces.astype(np.uint16)}
    return write_archive(path, **{f"{n}__{k}": part(m) for n, m in meshes.items() for k, part in parts.items()})


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "STL"])
def test_a_file_is_read_in_its_own_units_without_warning(tmp_path, suffix):
    path = tmp_path / f"block.{suffix}"
    path.write_bytes(_bytes(BOX.export(file_type=suffix.lower())))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        meshes = load_meshes(path)
    assert list(meshes) == ["block"]
    np.testing.assert_allclose(meshes["block"].bounds, BOX.bounds, atol=1e-6)
    assert meshes["block"].is_watertight and len(meshes["block"].faces) == 12


def test_a_folder_gives_its_mesh_files_in_order(tmp_path):
    BOX.export(tmp_path / "b.ply")
    BALL.export(tmp_path / "a.stl")
    (tmp_path / "notes.txt").write_text("not a mesh")
    meshes = load_meshes(tmp_path)
    assert list(meshes) == ["a", "b"]
    assert meshes["a"].volume == pytest.approx(BALL.volume, rel=1e-4)


def test_an_archive_and_the_choice_of_names(tmp_path):
    path = archive_of(tmp_path / "set.npz", box=BOX, ball=BALL)
    assert list(load_meshes(path)) == ["ball", "box"]
    chosen = load_meshes(str(path), names=["box"])
    assert list(chosen) == ["box"]
    assert chosen["box"].volume == pytest.approx(BOX.volume, rel=1e-4)
    with pytest.raises(UnknownNameError, match="unknown mesh of .*set.npz 'bal'; known: ball, box"):
        load_meshes(path, names=["bal"])


def test_a_mesh_with_holes_is_kept_with_a_warning(tmp_path):
    path = archive_of(tmp_path / "set.npz", shut=BOX, open=OPEN)
    with pytest.warns(UserWarning, match=r"not watertight, kept as they are \(1 of 2\): open"):
        meshes = load_meshes(path)
    assert len(meshes["open"].faces) == 11
    points, _ = trimesh.sample.sample_surface(meshes["open"], 100, seed=0)
    assert np.isfinite(points).all()
    assert meshes["open"].ray.intersects_any([BOX.centroid + [0, 0, 1]], [[0.02, 0.01, -1]]).all()


def test_normalised_meshes_have_one_size_and_place():
    mesh = normalise(BOX)
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -1 / 6, -1 / 3], [0.5, 1 / 6, 1 / 3]], atol=1e-9)
    assert mesh.is_watertight and BOX.extents.max() == pytest.approx(0.3)  # the given one is left alone


@pytest.mark.parametrize("vertices", [np.zeros((3, 3)), np.full((3, 3), np.nan), np.zeros((0, 3))])
def test_a_mesh_without_extent_cannot_be_normalised(vertices):
    faces = [[0, 1, 2]] if len(vertices) else np.zeros((0, 3), int)
    with pytest.raises(PwmGymError, match="expected faces, finite vertices and a positive extent"):
        normalise(trimesh.Trimesh(vertices, faces, process=False))


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("empty.obj", b"", "has no faces"),
        ("cloud.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces"),
        ("junk.glb", b"hello", "is no readable .glb mesh"),
        ("junk.ply", b"hello", "is no readable .ply mesh"),
        ("junk.npz", b"hello", "is no readable .npz archive"),
        ("mesh.step", b"hello", "has the suffix '.step'"),
    ],
)
def test_a_foreign_file_is_named_with_what_was_expected(tmp_path, name, content, complaint):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PwmGymError, match=f"{name} {complaint}.*; expected a"):
        load_meshes(tmp_path / name)


def test_missing_empty_and_ambiguous_places(tmp_path):
    with pytest.raises(PwmGymError, match="nowhere does not exist; expected a mesh file .*folder.*npz"):
        load_meshes(tmp_path / "nowhere")
    with pytest.raises(PwmGymError, match="holds no meshes; expected"):
        load_meshes(tmp_path)
    BOX.export(tmp_path / "a.ply")
    BOX.export(tmp_path / "a.stl")
    with pytest.raises(PwmGymError, match="holds 2 meshes of the name 'a'; expected one"):
        load_meshes(tmp_path)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"box__f": None}, "box/f missing or foreign"),
        ({"image": np.zeros(3)}, "image.* missing or foreign"),
        ({"box__f": np.zeros((0, 3), int)}, "'box' has no faces"),
        ({"box__f": BOX.faces + 1}, "integers from 0 to 7"),
        ({"box__f": BOX.faces - 1}, "integers from 0 to 7"),
        ({"box__f": BOX.faces.astype(float)}, "integers from 0 to 7"),
        ({"box__f": BOX.faces[:, :2]}, r"faces \(12, 2\)"),
        ({"box__v": BOX.vertices[:, :2]}, r"vertices \(8, 2\)"),
        ({"box__v": BOX.vertices * np.inf}, "8 vertices are not finite"),
    ],
)
def test_a_wrong_archive_is_told_from_a_right_one(tmp_path, change, complaint):
    arrays = {"box__v": BOX.vertices, "box__f": BOX.faces} | change
    path = write_archive(tmp_path / "set.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(PwmGymError, match=rf"set.npz: .*{complaint}"):
        load_meshes(path)


def test_an_archive_without_arrays_holds_no_meshes(tmp_path):
    with pytest.raises(PwmGymError, match="set.npz holds no meshes; expected"):
        load_meshes(write_archive(tmp_path / "set.npz"))


def _bytes(exported):
    return exported.encode() if isinstance(exported, str) else exported
