import numpy as np
import pytest

from pwm_gym.assets import GENERATED_OBJECTS, YCB_OBJECTS, generated_assets, generated_pieces
from pwm_gym.cli import main
from pwm_gym.errors import UnknownNameError
from pwm_gym.skills.object_grasps import find_grasps


def test_names_cannot_be_taken_for_ycbs():
    assert 8 <= len(GENERATED_OBJECTS) <= 12
    assert all(name.startswith("shape_") for name in GENERATED_OBJECTS)
    assert not set(GENERATED_OBJECTS) & set(YCB_OBJECTS)


@pytest.mark.parametrize("name", GENERATED_OBJECTS)
def test_shapes_are_convex_parts_centred_and_the_same_every_time(name):
    pieces = generated_pieces(name)
    assert all(piece.is_convex and piece.is_watertight and piece.volume > 0 for piece in pieces)
    bounds = np.stack([piece.bounds for piece in pieces])
    np.testing.assert_allclose(bounds[:, 0].min(0) + bounds[:, 1].max(0), 0.0, atol=1e-9)
    for a, b in zip(pieces, generated_pieces(name), strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)


def test_some_grasp_fits_each_shape():
    for name in ("shape_box", "shape_bottle", "shape_corner"):
        best = find_grasps(generated_pieces(name), count=4).grasps[0]
        assert best.score > 1.0 and best.width < 0.075


def test_an_unknown_shape_is_named():
    with pytest.raises(UnknownNameError, match="unknown generated shape 'shape_bos'.*Did you mean 'shape_box'"):
        generated_pieces("shape_bos")


def test_they_are_built_once_and_in_the_users_cache(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = generated_assets()
    assert tmp_path in folder.root.parents and folder.names() == GENERATED_OBJECTS
    files = {path: path.stat().st_mtime_ns for path in folder.root.rglob("*") if path.is_file()}
    assert generated_assets() == folder
    assert {path: path.stat().st_mtime_ns for path in files} == files
    (folder.model("shape_box") / "textured.obj").unlink()
    assert generated_assets().has("shape_box")
    main(["assets", "shapes"])
    assert f"12 shapes: {folder.base}" in capsys.readouterr().out
