"""The robot's cloud from joint angles: links of a URDF, sampled once and posed by forward kinematics.

Paper, section 3: P_robot = FK(q, URDF), of the end-effector links only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from pwm_gym.errors import PwmGymError, look_up, unknown_name
from pwm_gym.scene.cloud import sample_clouds
from pwm_gym.scene.layout import Layout
from pwm_gym.scene.se3 import transform

if TYPE_CHECKING:
    import trimesh

__all__ = ["RobotCloud"]

_MOVABLE = ("continuous", "prismatic", "revolute")
_GEOMETRIES = ("collision", "visual")
_SHAPES = ("box", "cylinder", "mesh", "sphere")


class RobotCloud:
    """Points on a robot's links, in the frame of the URDF's root link (a Panda's base), metres.

    Batched over any leading dimensions and differentiable; joint limits are not applied.

    Example:
        >>> robot = RobotCloud.from_urdf("panda_v2.urdf", ["panda_hand"])  # doctest: +SKIP
        >>> robot.points(torch.zeros(5, 9)).shape  # doctest: +SKIP
        torch.Size([5, 300, 3])
    """

    layout: Layout
    """The links as entities, in the order in which they were asked for; all are effectors."""
    meshes: dict[str, trimesh.Trimesh]
    """Entity name -> surface in its link's own frame, metres."""
    clouds: np.ndarray
    """Canonical points (N, 3), float32, metres, in the links' own frames."""
    joints: tuple[str, ...]
    """Names of a joint vector's components; those that mimic another may be left out where none were given."""

    def __init__(
        self,
        urdf: _Urdf,
        links: Mapping[str, str],
        joints: Sequence[str] | None,
        meshes: Mapping[str, trimesh.Trimesh],
        layout: Layout,
        seed: int,
    ) -> None:
        self.layout, self.meshes, self.clouds = layout, dict(meshes), sample_clouds(meshes, layout, seed)
        self._links, self._skeleton = tuple(links.values()), urdf.skeleton()
        self._chains: dict[tuple[torch.dtype, torch.device], Any] = {}
        chain = self._chain(torch.float64, torch.device("cpu"))
        if apart := [link for link in self._links if link not in chain.frame_to_idx]:
            raise PwmGymError(f"link {apart[0]!r} does not hang on the robot's root")
        order = chain.get_joint_parameter_names()
        own = tuple(j.name for j in urdf.joints.values() if j.movable)
        self.joints = own if joints is None else tuple(joints)
        vectors = [self.joints] if joints is not None else [own, tuple(n for n in own if urdf.joints[n].mimic is None)]
        self._drives = {len(given): _Drive.build(urdf, given, self._links, order) for given in vectors}

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        links: Iterable[str],
        joints: Sequence[str] | None = None,
        *,
        names: Mapping[str, str] | None = None,
        points: int | Mapping[str, int] = 300,
        geometry: Literal["collision", "visual"] = "collision",
        convex: bool = False,
        seed: int = 0,
    ) -> RobotCloud:
        """Read a URDF and sample the surfaces of some of its links.

        Args:
            urdf: path of the file; meshes named relatively are beside it, packages there or in a folder above.
            links: the links that are wanted.
            joints: names of a joint vector's components. By default all movable joints in the URDF's order; those
                that mimic another are then free to be left out of a vector.
            names: entity name -> link; a link without one keeps its own name.
            points: how many points each entity has, or entity name -> how many.
            geometry: which of the links' shapes are sampled.
            convex: whether each shape is its convex hull, as simulators take collision meshes.
            seed: of the sampling.

        Raises:
            FileNotFoundError: the URDF or one of its meshes does not exist.
            UnknownNameError: the URDF has no such link or joint, or a shape or joint type is not known.
            PwmGymError: it is no URDF, a wanted link has no shape, or a joint that moves it is not among ``joints``.
        """
        if geometry not in _GEOMETRIES:
            raise unknown_name("geometry", geometry, _GEOMETRIES)
        entities = _name_links(list(links), names or {})
        counts = [(name, points if isinstance(points, int) else look_up("entity", name, points)) for name in entities]
        layout = Layout.build(counts, driven=tuple(entities))
        try:
            robot = _Urdf(Path(urdf))
            meshes = {entity: robot.mesh(link, geometry, convex) for entity, link in entities.items()}
            return cls(robot, entities, joints, meshes, layout, seed)
        except (PwmGymError, FileNotFoundError):
            raise
        except Exception as error:  # the libraries' parsers have their own, down to AssertionError
            raise PwmGymError(f"{urdf} describes no robot ({error})") from error

    def poses(self, joints: Tensor | np.ndarray) -> Tensor:
        """Links' poses (..., E, 4, 4) at joint positions (..., J), in their dtype and on their device.

        Args:
            joints: radians (sliding joints: metres), in the order of :attr:`joints`.

        Raises:
            PwmGymError: another number of joints.
        """
        values = torch.as_tensor(joints)
        if not values.is_floating_point():
            values = values.double()
        values = self._drive(values.shape[-1] if values.ndim else 0)(values)
        chain = self._chain(values.dtype, values.device)
        flat = values.reshape(values.shape[:-1].numel(), values.shape[-1])
        found = chain.forward_kinematics(flat, chain.get_frame_indices(*self._links))
        poses = torch.stack([found[link].get_matrix() for link in self._links], 1)  # (B, E, 4, 4)
        return poses.reshape(*values.shape[:-1], *poses.shape[1:])

    def points(self, joints: Tensor | np.ndarray) -> Tensor:
        """The robot's points (..., N, 3) at joint positions (..., J); arguments and errors as for :meth:`poses`."""
        poses = self.poses(joints)
        clouds = torch.as_tensor(self.clouds).to(poses)
        parts = [transform(poses[..., i, :, :], clouds[e.slice]) for i, e in enumerate(self.layout)]
        return torch.cat(parts, -2)

    def _drive(self, count: int) -> _Drive:
        if count not in self._drives:
            expected = " or ".join(map(str, self._drives))
            raise PwmGymError(f"got {count} joints; expected {expected}: {', '.join(self.joints)}")
        return self._drives[count]

    def _chain(self, dtype: torch.dtype, device: torch.device) -> Any:
        """The kinematic chain in one dtype on one device: the library converts its tables in place."""
        if (dtype, device) not in self._chains:
            import pytorch_kinematics as pk

            self._chains[dtype, device] = pk.build_chain_from_urdf(self._skeleton).to(dtype=dtype, device=device)
        return self._chains[dtype, device]


class _Drive(NamedTuple):
    """How a joint vector moves a chain's joints: each is one component, times a factor, plus an offset.

    pytorch-kinematics ignores mimic joints: its chains want a value of their own for each.
    """

    source: Tensor
    factor: Tensor
    offset: Tensor

    @classmethod
    def build(cls, urdf: _Urdf, given: Sequence[str], links: Sequence[str], order: Sequence[str]) -> _Drive:
        """Of the ``given`` joints, for a chain's joints in its ``order``; all that move ``links`` must get values."""
        for name in given:
            look_up("joint", name, urdf.joints)
        found = {name: urdf.follow(name, given) for name in order}
        for link in links:
            for joint in urdf.path(link):
                if joint.movable and found[joint.name] is None:
                    raise PwmGymError(
                        f"no value for joint {joint.name!r}, which moves {link!r}; got {', '.join(given)}"
                    )
        source, factor, offset = zip(*(v or (0, 0.0, 0.0) for v in found.values()), strict=True)
        return cls(torch.tensor(source), *(torch.tensor(x, dtype=torch.float64) for x in (factor, offset)))

    def __call__(self, joints: Tensor) -> Tensor:
        """Values (..., K) of the chain's joints for vectors (..., J)."""
        chosen = joints[..., self.source.to(joints.device)]
        return chosen * self.factor.to(joints) + self.offset.to(joints)


class _Joint(NamedTuple):
    name: str
    parent: str
    child: str
    movable: bool
    mimic: tuple[str, float, float] | None
    """Name, multiplier and offset of the joint that it follows."""


class _Urdf:
    """A URDF's links with their shapes, and its joints."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise FileNotFoundError(f"{path} does not exist; expected a URDF")
        try:
            robot = ElementTree.fromstring(path.read_bytes())
        except ElementTree.ParseError as error:
            raise PwmGymError(f"{path} is not a URDF: {error}") from error
        self._folder = path.resolve().parent
        self._links = {link.get("name", ""): link for link in robot.findall("link")}
        self._elements = robot.findall("joint")
        self.joints = {joint.name: joint for joint in map(_joint, self._elements)}
        if robot.tag != "robot" or not any(joint.movable for joint in self.joints.values()):
            raise PwmGymError(f"{path} is not a URDF of a robot with movable joints")
        self._movers = {joint.child: joint for joint in self.joints.values()}

    def mesh(self, link: str, geometry: str, convex: bool) -> trimesh.Trimesh:
        """Union of a link's collision or visual shapes, or of their convex hulls, in its own frame."""
        import trimesh

        parts = []
        for shape in look_up("link", link, self._links).findall(geometry):
            mesh = self._shape(shape).convex_hull if convex else self._shape(shape)
            mesh.apply_transform(_origin(shape))
            parts.append(mesh)
        if not parts:
            raise PwmGymError(f"link {link!r} has no {geometry} shape to sample points from")
        return trimesh.util.concatenate(parts)

    def path(self, link: str) -> list[_Joint]:
        """The joints between the root and a link."""
        joints = []
        while (joint := self._movers.get(link)) is not None:
            if joint in joints:
                raise PwmGymError(f"link {link!r} hangs on itself, by the joint {joint.name!r}")
            joints.append(joint)
            link = joint.parent
        return joints

    def follow(self, name: str, given: Sequence[str]) -> tuple[int, float, float] | None:
        """Index, factor and offset by which a joint follows one of the ``given``; None if it follows none."""
        if name in given:
            return given.index(name), 1.0, 0.0
        if (mimic := self.joints[name].mimic) is None:
            return None
        leader, multiplier, offset = mimic
        found = self.follow(look_up("joint", leader, self.joints).name, given)
        return found and (found[0], multiplier * found[1], multiplier * found[2] + offset)

    def skeleton(self) -> bytes:
        """The URDF without shapes, masses and limits: the library needs none of them and warns of many.

        Axes and origins are written out, because the library's default axis is z, and the standard's is x.
        """
        robot = Element("robot", name="robot")
        for link in self._links:
            ElementTree.SubElement(robot, "link", name=link)
        for element in self._elements:
            joint = ElementTree.SubElement(robot, "joint", element.attrib)
            for tag, defaults in _JOINT_PARTS.items():
                part = element.find(tag)
                ElementTree.SubElement(joint, tag, defaults | (part.attrib if part is not None else {}))
        return ElementTree.tostring(robot)

    def _shape(self, element: Element) -> trimesh.Trimesh:
        """Surface of one shape, before its origin is applied; URDF's cylinders lie along z."""
        from trimesh import creation

        shape = next((part for tag in _SHAPES if (part := element.find(f"geometry/{tag}")) is not None), None)
        if shape is None:
            found = [part.tag for part in element.iterfind("geometry/*")]
            raise unknown_name("shape", ", ".join(found), _SHAPES)
        if shape.tag == "box":
            return creation.box(_numbers(shape, "size"))
        if shape.tag == "sphere":
            return creation.icosphere(3, *_numbers(shape, "radius"))
        if shape.tag == "cylinder":
            return creation.cylinder(*_numbers(shape, "radius"), *_numbers(shape, "length"))
        return self._load(shape)

    def _load(self, shape: Element) -> trimesh.Trimesh:
        """A mesh file's surface without its textures, scaled."""
        import trimesh

        mesh = trimesh.load(self._find(shape.get("filename", "")), force="mesh")
        return trimesh.Trimesh(mesh.vertices * _numbers(shape, "scale", "1 1 1"), mesh.faces)

    def _find(self, name: str) -> Path:
        """A mesh file beside the URDF; packages are looked for in the folders above it too."""
        package, _, plain = name.removeprefix("package://").partition("/")
        choices = [self._folder / name.removeprefix("file://")]
        if name.startswith("package://"):
            choices = [folder / package / plain for folder in (self._folder, *self._folder.parents)]
            choices.append(self._folder / plain)
        for choice in choices:
            if choice.is_file():
                return choice
        raise FileNotFoundError(f"mesh {name!r} is not found from {self._folder}")


_JOINT_PARTS: dict[str, dict[str, str]] = {
    "origin": {"xyz": "0 0 0", "rpy": "0 0 0"},
    "axis": {"xyz": "1 0 0"},
    "parent": {},
    "child": {},
}


def _joint(element: Element) -> _Joint:
    name, kind = element.get("name", ""), element.get("type", "")
    if kind not in (*_MOVABLE, "fixed"):
        raise unknown_name(f"type of joint {name!r}", kind, (*_MOVABLE, "fixed"))
    parent, child = (part.get("link", "") for tag in ("parent", "child") for part in element.iterfind(tag))
    mimic = None
    if (other := element.find("mimic")) is not None:
        mimic = other.get("joint", ""), _numbers(other, "multiplier", "1")[0], _numbers(other, "offset", "0")[0]
    return _Joint(name, parent, child, kind in _MOVABLE, mimic)


def _origin(element: Element) -> np.ndarray:
    """Pose (4, 4) of an element's <origin>; roll, pitch and yaw are about fixed axes."""
    pose = np.eye(4)
    if (origin := element.find("origin")) is not None:
        pose[:3, :3] = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0")).as_matrix()
        pose[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return pose


def _numbers(element: Element, attribute: str, default: str = "") -> list[float]:
    text = element.get(attribute, default)
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if not numbers:
        raise PwmGymError(f"<{element.tag}> has {attribute}={text!r}; expected numbers")
    return numbers


def _name_links(links: Sequence[str], names: Mapping[str, str]) -> dict[str, str]:
    """Entity name -> link, in the order of ``links``."""
    if not links:
        raise PwmGymError("no links; expected at least one")
    for link in names.values():
        if link not in links:
            raise unknown_name("link", link, links)
    entities = {link: entity for entity, link in names.items()}
    return {entities.get(link, link): link for link in links}
