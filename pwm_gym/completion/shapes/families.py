"""Random watertight shapes of household kind, for training where no scanned objects are wanted.

Every parameter is invented here; no data set is copied.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import trimesh
from manifold3d import Manifold

from pwm_gym.completion.meshes import normalise
from pwm_gym.completion.shapes import fruit, solids, tools, vessels
from pwm_gym.errors import PwmGymError, unknown_name

__all__ = ["FAMILIES", "MAX_FACES", "random_shape"]

MAX_FACES = 4000
"""Most triangles of a shape."""

_BUILDERS: dict[str, Callable[[np.random.Generator], Manifold]] = {
    "blend": solids.blend,
    "boolean": solids.boolean,
    "bottle": vessels.bottle,
    "bowl": vessels.bowl,
    "box": solids.box,
    "cutlery": tools.cutlery,
    "extrusion": solids.extrusion,
    "fruit": fruit.fruit,
    "gadget": tools.gadget,
    "lathe": vessels.lathe,
    "mug": vessels.mug,
    "ring": solids.ring,
    "tool": tools.tool,
    "toy": solids.toy,
}
_STRETCHED = 0.25  # part of the shapes whose axes are scaled at random, so that proportions vary beyond their builders'
_ATTEMPTS = 20  # for one shape; none of 2,800 attempts failed with manifold3d 3.5.4


def random_shape(rng: np.random.Generator, family: str | None = None) -> trimesh.Trimesh:
    """A random watertight, consistently oriented mesh: bounding box centred at the origin, its longest side 1.

    Upright things stand along z, cutlery lies along x. At most ``MAX_FACES`` triangles; 15 ms on average on one core.

    Args:
        rng: decides everything; the same state gives the same mesh.
        family: one of ``FAMILIES``; None draws one, each equally likely.

    Raises:
        UnknownNameError: no such family.
    """
    if family is None:
        family = str(rng.choice(list(FAMILIES)))
    if family not in FAMILIES:
        raise unknown_name("family of shapes", family, FAMILIES)
    for _ in range(_ATTEMPTS):
        try:
            return FAMILIES[family](rng)
        except PwmGymError as error:
            failure = error
    raise PwmGymError(f"no {family} in {_ATTEMPTS} attempts: {failure}") from failure


def _shape(builder: Callable[[np.random.Generator], Manifold], rng: np.random.Generator) -> trimesh.Trimesh:
    """Mesh of one attempt of ``builder``.

    Raises:
        PwmGymError: the random parameters fit no solid.
    """
    solid = builder(rng)
    if rng.random() < _STRETCHED:
        solid = solid.scale(list(rng.uniform(0.75, 1.25, 3)))
    solid = _reduced(solid)
    if not 0 < solid.num_tri() <= MAX_FACES or not solid.volume() > 0:
        raise PwmGymError(f"{solid.num_tri()} faces around a volume of {solid.volume():.3g} ({solid.status().name})")
    raw = solid.to_mesh64()
    mesh = trimesh.Trimesh(raw.vert_properties[:, :3], raw.tri_verts, process=False)
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        raise PwmGymError("its edges do not join two faces each")
    return normalise(mesh)


def _reduced(solid: Manifold) -> Manifold:
    """``solid`` with at most ``MAX_FACES`` triangles, as little changed as that allows."""
    low, high = np.reshape(solid.bounding_box(), (2, 3))
    tolerance = 2e-4 * float((high - low).max())
    for _ in range(6):
        if solid.num_tri() <= MAX_FACES:
            break
        solid, tolerance = solid.simplify(tolerance), 2 * tolerance
    return solid


FAMILIES: dict[str, Callable[[np.random.Generator], trimesh.Trimesh]] = {
    name: partial(_shape, builder) for name, builder in _BUILDERS.items()
}
"""Makers of one kind of shape each. One attempt; ``random_shape`` tries again where the parameters do not fit."""
