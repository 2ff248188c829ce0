"""Which entities of a layout play which part in the compact model; worked out once a layout."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pwm_gym.errors import SceneError
from pwm_gym.robots.joints import JointTree
from pwm_gym.scene import Layout
from pwm_gym.scene.joint import JOINT_KINDS
from pwm_gym.scene.se3 import inverse, matrix_from_pose7

__all__ = ["Plan"]


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
            itself=torch.tensor([[bodies[p] == bodies[m] for p in range(partners)] for m in movers], device=device),
            ridden=len({*bodies}) < len(bodies),
            tree=JointTree(sorted_layout, articulated, attached).to(device),
            floor=layout.floor,
            walls=inverse(poses).to(device),
            wall_half=torch.tensor([s.half for s in walls], dtype=torch.float32, device=device).reshape(-1, 3),
        )

    @property
    def movers(self) -> list[int]:
        """Places in :attr:`order` of what can move: loose entities, then articulated ones."""
        return self.loose + self.articulated

    @property
    def sorted(self) -> bool:
        """Whether the layout has the model's order already."""
        return self.order == self.back and self.order == sorted(self.order)


def _check_robot(layout: Layout, links: Layout) -> None:
    """Raise :class:`SceneError` unless the driven entities of ``layout`` are those of ``links``."""
    found = {e.name: e.joint for e in layout if e.driven}
    if found.keys() != {*links.names}:
        raise SceneError(f"the scene's robot has {', '.join(found) or 'no link'}; expected {', '.join(links.names)}")
    for e in links:
        if found[e.name].kind != e.joint.kind or found[e.name].parent != e.joint.parent:
            told = f"{found[e.name].kind} on {found[e.name].parent}"
            raise SceneError(f"the joint of {e.name!r} is {told}; the model's is {e.joint.kind} on {e.joint.parent}")
