"""Which entities of a layout play which part in the compact model; worked out once a layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pwm_gym.errors import SceneError
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Layout
from pwm_gym.scene.joint import JOINT_KINDS, Joint
from pwm_gym.scene.se3 import inverse, matrix_from_pose7

__all__ = ["Places", "Plan"]

Places = slice | Tensor
"""Places along a dimension of a tensor: a slice where they follow each other, which copies nothing."""
_APART = 1.0  # metres that part a mover from itself, and from what hangs on it
_UP = ((0.0, 0.0, 1.0, 0.0),)  # row that gives the height of a homogeneous point


@dataclass(frozen=True, eq=False)
class Plan:
    """Positions in a layout of what the model moves, and its static surroundings."""

    layout: Layout
    order: list[int]
    """The layout's entities as the model sees them: the robot's L links in its own order, then all others."""
    back: list[int]
    """Place of each of the layout's entities in :attr:`order`."""
    links: int
    """L."""
    loose: list[int]
    """Places in :attr:`order` of what contact moves freely."""
    articulated: list[int]
    """Places of what contact moves along a joint, parents first."""
    kinds: Tensor
    """Joint kind (P - L,) of each entity behind the links."""
    partners: int
    """How many of :attr:`order`, its first, may touch a mover: all, or the links alone where the mover is all else."""
    attached: list[int]
    """Places of what is fixed to something that moves."""
    itself: Tensor
    """Bool (F, partners): each mover's own place, and the parts of a loose body that hang together."""
    ridden: bool
    """Whether something hangs on a loose entity."""
    tree: JointTree
    """Joints of the articulated movers, of entities in :attr:`order`, and what is fixed to something that moves."""
    floor: float
    """Height of the horizontal support without edges, metres."""
    walls: Tensor
    """Inverse poses (S, 4, 4) of the other supports."""
    wall_half: Tensor
    """Half their sides (S, 3)."""
    places: list[int]
    """Places in :attr:`order` of what can move, F of them: loose entities, then articulated ones."""
    movers: Places
    """The same."""
    hands: Places
    """Places of the hands."""
    loose_places: Places
    """Those of :attr:`loose`."""
    carriers: Places
    """Places of partners whose next poses are known before the loose entities'."""
    carried: bool
    """Whether there are any."""
    wall_rows: Tensor
    """Rows (3, S, 4) that take points of the world to the walls' axes."""
    up: Tensor
    """Row (1, 4) that takes them to their height."""
    apart: Tensor
    """Metres (F, P', 1) by which movers are parted from :attr:`itself`; P' counts partners and walls."""
    joined: Tensor
    """Metres (F, partners, 1) by which movers are parted from themselves, and from what they hang on along a joint: a
    drawer is always inside its cabinet's box, which tells nothing."""
    sorted: bool
    """Whether the layout has the model's order already."""

    @classmethod
    def build(cls, layout: Layout, links: Layout, device: torch.device) -> Plan:
        """The plan of ``layout`` for a model of the robot ``links``.

        Raises:
            SceneError: the scene's robot is not the model's.
        """
        _check_robot(layout, links)
        order = [layout.index(e.name) for e in links] + [i for i, e in enumerate(layout) if not e.driven]
        sorted_layout = Layout.build(
            [(layout.entities[i].name, layout.entities[i].points) for i in order],
            links.names,
            {e.name: e.joint for e in layout},
        )
        loose, articulated = list(sorted_layout.loose), list(sorted_layout.articulated)
        attached = [i for i in sorted_layout.attached if i >= len(links)]
        movers = loose + articulated
        roots = [sorted_layout.root(i) for i in range(len(order))]
        bodies = [root if root in loose else i for i, root in enumerate(roots)]
        partners = len(links) if len(links) and len(order) == len(links) + 1 else len(order)
        walls = [s for s in layout.supports if not s.plane]
        poses = matrix_from_pose7(torch.tensor([s.origin for s in walls], dtype=torch.float32).reshape(-1, 7))
        kinds = [JOINT_KINDS.index(e.joint.kind) for e in sorted_layout.entities[len(links) :]]
        itself = torch.tensor([[bodies[p] == bodies[m] for p in range(partners)] for m in movers], device=device)
        parents = [sorted_layout.entities[m].joint.parent for m in movers]
        hung = torch.tensor([[n == p for n in sorted_layout.names[:partners]] for p in parents], device=device)
        carriers = [k for k in (*range(len(links)), *articulated, *attached) if k < partners]
        inverses = inverse(poses).to(device)
        from_boxes = nn.functional.pad(_APART * itself, (0, len(walls)))  # no mover is a wall
        return cls(
            layout=layout,
            order=order,
            back=[order.index(i) for i in range(len(layout))],
            links=len(links),
            loose=loose,
            articulated=articulated,
            kinds=torch.tensor(kinds, dtype=torch.long, device=device),
            partners=partners,
            attached=attached,
            itself=itself,
            ridden=len({*bodies}) < len(bodies),
            tree=JointTree(sorted_layout, articulated, attached).to(device),
            floor=layout.floor,
            walls=inverses,
            wall_half=torch.tensor([s.half for s in walls], dtype=torch.float32, device=device).reshape(-1, 3),
            places=movers,
            movers=_places(movers, device),
            hands=_places(links.hands, device),
            loose_places=_places(loose, device),
            carriers=_places(carriers, device),
            carried=bool(carriers),
            wall_rows=inverses[:, :3].transpose(0, 1),
            up=torch.tensor(_UP, device=device),
            apart=from_boxes.unsqueeze(-1) if movers else torch.empty(0),
            joined=_APART * (itself | hung).unsqueeze(-1) if movers else torch.empty(0),
            sorted=order == sorted(order),
        )

    @property
    def touchable(self) -> int:
        """P': how many partners and walls there are."""
        return self.partners + len(self.walls)

    @property
    def box_rows(self) -> tuple[int, int, int]:
        """Rows that are told of a mover's point at one time: in boxes' axes, its height, in the frame of reference."""
        return 3 * self.touchable, 1, 3

    def with_walls(self, partners: Tensor, walls: Tensor, dim: int) -> Tensor:
        """What is known of partners (B, ...) with the same of walls, equal in all scenes, behind it along ``dim``."""
        if not len(walls):
            return partners
        return torch.cat([partners, walls.expand(len(partners), *walls.shape)], dim)


def _places(places: Sequence[int], device: torch.device) -> Places:
    """Places as a slice, where they can be one."""
    start = places[0] if places else 0
    if list(places) == list(range(start, start + len(places))):
        return slice(start, start + len(places))
    return torch.tensor(places, device=device)


def _check_robot(layout: Layout, links: Layout) -> None:
    """Raise :class:`SceneError` unless the driven entities of ``layout`` are those of ``links``."""
    found = {e.name: e.joint for e in layout if e.driven}
    if found.keys() != {*links.names}:
        raise SceneError(f"the scene's robot has {', '.join(found) or 'no link'}; expected {', '.join(links.names)}")
    for e in links:
        if found[e.name].kind != e.joint.kind or found[e.name].parent != e.joint.parent:
            told = f"{found[e.name].kind} on {found[e.name].parent}"
            raise SceneError(f"the joint of {e.name!r} is {told}; the model's is {e.joint.kind} on {e.joint.parent}")
        if found[e.name].mimic != e.joint.mimic:
            rules = " and ".join(_rule(joint) for joint in (found[e.name], e.joint))
            raise SceneError(f"the joint of {e.name!r} follows another rule than the model's: {rules}")


def _rule(joint: Joint) -> str:
    """What a joint follows, in words."""
    mimic = joint.mimic
    return "none" if mimic is None else f"{mimic.multiplier:g} * {mimic.entity} + {mimic.offset:g}"
