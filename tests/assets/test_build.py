import json
import warnings

import numpy as np
import pytest
import trimesh

from pwm_gym.assets import AssetFolder, build_ycb
from pwm_gym.assets.pieces import PieceConfig, convex_pieces, surface_deviation
from pwm_gym.cli import main
from pwm_gym.errors import PwmGymError, UnknownNameError

CORNER = trimesh.boolean.union(
    [
        trimesh.creation.box([0.1, 0.03, 0.035]),
        trimesh.creation.box([0.03, 0.06, 0.035], trimesh.transformations.translation_matrix([0.035, 0.04, 0.0])),
    ],
    engine="manifold",
)
MESHES = {
    "061_foam_brick": trimesh.creation.box([0.05, 0.08, 0.05], trimesh.transformations.translation_matrix([1, 2, 3])),
    "058_golf_ball": trimesh.creation.icosphere(3, 0.021),
    "048_hammer": CORNER,
}


def write_archive(path, meshes):
    parts = {}
    for name, mesh in meshes.items():
        parts[f"{name}/v"] = np.asarray(mesh.vertices, np.float32)
        parts[f"{name}/f"] = np.asarray(mesh.faces, np.uint16)
    np.savez(path, **parts)
    return path


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    """Three objects with names of YCB: a box off the origin, a ball and a corner."""
    return write_archive(tmp_path_factory.mktemp("meshes") / "ycb.npz", MESHES)


HAS_COACD = True
try:
    import coacd  # noqa: F401
except ImportError:
    HAS_COACD = False
needs_coacd = pytest.mark.skipif(not HAS_COACD, reason="needs the extra 'assets'")
EASY = ("058_golf_ball", "061_foam_brick")  # one hull each


def test_the_folder_is_the_one_that_maniskill_reads(archive, tmp_path):
    folder = build_ycb(archive, tmp_path, EASY)
    base = tmp_path / "data" / "assets" / "mani_skill2_ycb"
    info = json.loads((base / "info_pick_v0.json").read_text())
    assert list(info) == list(EASY) == list(folder.names())
    assert set(info["058_golf_ball"]) == {"bbox", "scales", "density"}
    np.testing.assert_allclose(info["061_foam_brick"]["bbox"]["max"], [0.025, 0.04, 0.025], atol=1e-5)
    for name in EASY:
        mesh = trimesh.load(base / "models" / name / "textured.obj", force="mesh")
        np.testing.assert_allclose(mesh.bounds.mean(0), 0.0, atol=1e-5)  # recentred
        np.testing.assert_allclose(mesh.extents, MESHES[name].extents, atol=1e-5)
        assert len(folder.pieces(name)) == 1


def test_author_licence_and_changes_are_told(archive, tmp_path):
    text = (build_ycb(archive, tmp_path, EASY).base / "ATTRIBUTION.txt").read_text()
    assert "Calli" in text and "CC BY 4.0" in text and "bounding box is centred" in text


def test_pieces_are_written_as_text(archive, tmp_path):
    """SAPIEN's reader crashes on some binary files."""
    path = build_ycb(archive, tmp_path, EASY).model("061_foam_brick") / "collision.ply"
    assert path.read_bytes().startswith(b"ply\nformat ascii")


def test_what_is_there_is_kept_and_the_rest_is_added(archive, tmp_path):
    first = build_ycb(archive, tmp_path, EASY[:1])
    path = first.model(EASY[0]) / "collision.ply"
    before = path.stat().st_mtime_ns
    second = build_ycb(archive, tmp_path, EASY)
    assert path.stat().st_mtime_ns == before and second.names() == EASY


def test_an_object_without_all_its_files_is_built_anew(archive, tmp_path):
    folder = build_ycb(archive, tmp_path, EASY)
    (folder.model(EASY[0]) / "collision.ply").unlink()
    assert not folder.has(EASY[0])
    assert build_ycb(archive, tmp_path, EASY).has(EASY[0])


@pytest.mark.slow
def test_processes_build_the_same(archive, tmp_path):
    one, two = build_ycb(archive, tmp_path / "1", EASY), build_ycb(archive, tmp_path / "2", EASY, workers=2)
    for name in EASY:
        files = [folder.model(name) / "collision.ply" for folder in (one, two)]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_a_folder_of_meshes_is_read(tmp_path):
    (tmp_path / "meshes").mkdir()
    MESHES["058_golf_ball"].export(tmp_path / "meshes" / "058_golf_ball.stl")
    MESHES["061_foam_brick"].export(tmp_path / "meshes" / "061_foam_brick.obj")
    assert build_ycb(tmp_path / "meshes", tmp_path / "out").names() == EASY


def with_vertices(mesh, vertices):
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


BOX = MESHES["061_foam_brick"]
NAN = np.where(np.arange(len(BOX.vertices))[:, None] == 0, np.nan, BOX.vertices)
FLAT = BOX.vertices * [1, 1, 0]


@pytest.mark.parametrize(
    ("meshes", "message"),
    [
        ({"061_foam_brik": BOX}, "unknown YCB object '061_foam_brik'.*Did you mean '061_foam_brick'"),
        ({"061_foam_brick": with_vertices(BOX, NAN)}, "'061_foam_brick': 1 vertices are not finite"),
        ({"061_foam_brick": trimesh.Trimesh()}, "'061_foam_brick' has no faces"),
        ({"061_foam_brick": with_vertices(BOX, 1000 * BOX.vertices)}, "061_foam_brick is 80 long; expected metres"),
        ({"061_foam_brick": with_vertices(BOX, FLAT)}, "061_foam_brick: .*expected a mesh that is not flat"),
    ],
)
def test_a_bad_mesh_is_one_error(tmp_path, meshes, message):
    path = write_archive(tmp_path / "bad.npz", meshes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(PwmGymError, match=message):
            build_ycb(path, tmp_path / "out")
    assert not (tmp_path / "out").exists() or not AssetFolder(tmp_path / "out").exists()


def test_bad_sources_are_one_error(archive, tmp_path):
    with pytest.raises(UnknownNameError, match="unknown mesh of .*'011_banana'"):
        build_ycb(archive, tmp_path, ("011_banana",))
    with pytest.raises(PwmGymError, match="does not exist"):
        build_ycb(tmp_path / "none.npz", tmp_path)
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(PwmGymError, match="no readable .npz archive"):
        build_ycb(tmp_path / "text.npz", tmp_path)
    np.savez(tmp_path / "half.npz", **{"011_banana/v": BOX.vertices})
    with pytest.raises(PwmGymError, match="011_banana/f missing or foreign"):
        build_ycb(tmp_path / "half.npz", tmp_path)
    with pytest.raises(PwmGymError, match="workers is 0"):
        build_ycb(archive, tmp_path, EASY, workers=0)


def test_a_broken_list_is_one_error(tmp_path):
    folder = AssetFolder(tmp_path)
    folder.info_path.parent.mkdir(parents=True)
    folder.info_path.write_text("{")
    with pytest.raises(PwmGymError, match="info_pick_v0.json is no readable list of objects"):
        folder.names()


@needs_coacd
def test_a_corner_is_cut_into_pieces_that_keep_its_hollow():
    pieces = convex_pieces(CORNER, PieceConfig(max_pieces=6))
    assert 2 <= len(pieces) <= 6 and all(piece.is_convex for piece in pieces)
    assert surface_deviation(CORNER, pieces) < 0.5 * surface_deviation(CORNER, [CORNER.convex_hull])
    assert sum(piece.volume for piece in pieces) < 1.1 * CORNER.volume


def test_without_coacd_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "coacd", None)
    with pytest.raises(PwmGymError, match=r'pip install "pwm-gym\[assets\]"'):
        convex_pieces(CORNER)
    assert len(convex_pieces(BOX)) == 1


def test_hulls_have_few_vertices():
    assert len(convex_pieces(trimesh.creation.icosphere(4, 0.03))[0].vertices) <= 64


def test_the_command(archive, tmp_path, capsys):
    main(["assets", "ycb", "--from", str(archive), "--out", str(tmp_path), "--objects", *EASY])
    assert f"2 objects: {AssetFolder(tmp_path).base}" in capsys.readouterr().out
    with pytest.raises(SystemExit, match=r"^pwm-gym: .*nowhere.npz does not exist"):
        main(["assets", "ycb", "--from", "nowhere.npz", "--out", str(tmp_path)])
