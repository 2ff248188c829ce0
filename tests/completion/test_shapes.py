import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from pwm_gym.completion.shapes import FAMILIES, MAX_FACES, families, random_shape
from pwm_gym.errors import PwmGymError, UnknownNameError


@pytest.fixture(scope="module")
def many():
    rng = np.random.default_rng(0)
    return [random_shape(rng) for _ in range(250)]


def proportions(meshes):
    """Middle and shortest side (n, 2) against the longest."""
    return np.array([np.sort(mesh.extents)[1::-1] for mesh in meshes])


def fill(meshes):
    return np.array([mesh.volume / np.prod(mesh.extents) for mesh in meshes])


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", range(4))
def test_shapes_are_closed_oriented_and_of_one_size(family, seed):
    mesh = random_shape(np.random.default_rng(seed), family)
    assert isinstance(mesh, trimesh.Trimesh)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    assert np.isfinite(mesh.vertices).all() and 12 <= len(mesh.faces) <= MAX_FACES
    assert mesh.extents.max() == pytest.approx(1)
    np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-9)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_generator_decides(family):
    a, b, c = (random_shape(np.random.default_rng(seed), family) for seed in (5, 5, 6))
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.faces, b.faces)
    assert a.vertices.shape != c.vertices.shape or not np.allclose(a.vertices, c.vertices)


def test_one_generator_gives_shape_after_shape():
    rng = np.random.default_rng(0)
    volumes = [random_shape(rng, "box").volume for _ in range(5)]
    assert len(np.unique(np.round(volumes, 6))) == 5


def test_all_shapes_of_a_long_run_are_sound(many):
    assert all(mesh.is_volume and len(mesh.faces) <= MAX_FACES for mesh in many)


def test_proportions_range_from_sticks_and_plates_to_dice(many):
    middle, shortest = proportions(many).T
    assert (middle < 0.25).mean() > 0.08  # sticks
    assert ((middle > 0.7) & (shortest < 0.3)).mean() > 0.06  # plates
    assert (shortest > 0.8).mean() > 0.08  # dice, balls
    assert np.ptp(middle) > 0.85 and np.ptp(shortest) > 0.85


def test_shapes_range_from_thin_shells_to_full_blocks(many):
    thin, full = np.quantile(fill(many), [0.1, 0.9])
    assert thin < 0.12 and full > 0.65


def test_each_family_varies():
    for family in FAMILIES:
        meshes = [random_shape(np.random.default_rng(seed), family) for seed in range(12)]
        spread = np.ptp(np.column_stack([proportions(meshes), fill(meshes)]), axis=0)
        assert spread.max() > 0.25, f"{family}: {spread}"


def test_shapes_do_not_pass_through_themselves(many):
    """A ray that enters a solid leaves it before it enters again."""
    rng = np.random.default_rng(1)
    for mesh in many[:40]:
        through = rng.uniform(-0.4, 0.4, (50, 3)) * mesh.extents
        ways = rng.normal(size=(50, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        starts = through - 3 * ways
        hits, ray, face = mesh.ray.intersects_location(starts, ways)
        order = np.lexsort([((hits - starts[ray]) * ways[ray]).sum(1), ray])
        enters = ((mesh.face_normals[face] * ways[ray]).sum(1) < 0)[order]
        same = np.diff(ray[order]) == 0
        assert (enters[1:] == enters[:-1])[same].mean() < 0.05 if same.any() else len(hits) == 0


def test_parameters_that_fit_no_solid_are_drawn_anew(monkeypatch):
    box = FAMILIES["box"]
    calls = []

    def seldom(rng):
        calls.append(rng.random())
        if len(calls) < 4:
            raise PwmGymError("degenerate")
        return box(rng)

    monkeypatch.setitem(FAMILIES, "box", seldom)
    assert random_shape(np.random.default_rng(0), "box").is_volume
    assert len(set(calls)) == 4


def test_a_family_that_never_succeeds_says_so(monkeypatch):
    def never(rng):
        raise PwmGymError("degenerate")

    monkeypatch.setitem(FAMILIES, "box", never)
    with pytest.raises(PwmGymError, match="no box in 20 attempts: degenerate"):
        random_shape(np.random.default_rng(0), "box")


def test_what_is_no_solid_is_refused():
    for nothing in (Manifold(), Manifold.cube([1, 1, 0]), Manifold.cube([1, 1, 1]) - Manifold.cube([2, 2, 2])):
        with pytest.raises(PwmGymError, match="faces around a volume of 0 "):
            families._shape(lambda rng, solid=nothing: solid, np.random.default_rng(0))


def test_an_unknown_family_is_named():
    with pytest.raises(UnknownNameError, match="unknown family of shapes 'cups'; known: blend, .*bowl"):
        random_shape(np.random.default_rng(0), "cups")
