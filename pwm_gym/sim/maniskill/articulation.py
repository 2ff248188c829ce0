"""Articulated objects of a ManiSkill scene, such as a cabinet with its drawer: finding and restoring them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pwm_gym.scene import within_limits
from pwm_gym.scene.poses import compose, relative, rotation
from pwm_gym.sim.maniskill.poses import pose7

__all__ = ["articulated_links", "restore_articulations"]


def articulated_links(scene: Any, robot: Any) -> dict[str, Any]:
    """``"articulation/link"`` -> ManiSkill's link, of all that is articulated but the robot."""
    found = {}
    for name, articulation in scene.articulations.items():
        if articulation is not robot:
            found.update({f"{name}/{link.name}": link for link in articulation.get_links()})
    return found


def restore_articulations(
    links: Mapping[str, Any], now: Mapping[str, np.ndarray], before: Mapping[str, np.ndarray], rate: float
) -> None:
    """Place roots and joints where poses of their links say, with the joints' velocities.

    Joints whose links are no entities stay where they are.

    Args:
        links: entity -> SAPIEN's link.
        now: entity -> its pose (7,) in the simulator's world.
        before: the same one control step before.
        rate: control steps per second.

    Raises:
        SceneError: a joint is beyond its limits.
    """
    entities = {link.name: entity for entity, link in links.items()}  # SAPIEN's names are unique in a scene
    for articulation in {id(link.articulation): link.articulation for link in links.values()}.values():
        root = entities.get(articulation.root.name)
        if root is not None:
            articulation.set_root_pose(_sapien_pose(now[root]))
        positions, velocities = np.array(articulation.qpos), np.array(articulation.qvel)
        for k, joint in enumerate(articulation.active_joints):
            entity = entities.get(joint.child_link.name)
            if entity is None:
                continue
            parent = entities.get(joint.parent_link.name)
            fixed = pose7(joint.parent_link.entity.pose)
            position = _position(joint, fixed if parent is None else now[parent], now[entity])
            last = _position(joint, fixed if parent is None else before[parent], before[entity])
            positions[k] = within_limits(f"the joint of {entity!r}", position, *map(float, joint.limits[0]))
            velocities[k] = (position - last) * rate
        articulation.set_qpos(positions)
        articulation.set_qvel(velocities)


def _position(joint: Any, parent: np.ndarray, child: np.ndarray) -> float:
    """Position of a joint about or along its x axis, of its links' poses (7,)."""
    frame = compose(parent, pose7(joint.pose_in_parent))
    moved = relative(frame, compose(child, pose7(joint.pose_in_child))[None])[0]
    if joint.type == "prismatic":
        return float(moved[0])
    return float(rotation(moved).as_rotvec()[0])


def _sapien_pose(pose: np.ndarray) -> Any:
    import sapien

    return sapien.Pose(pose[:3], pose[3:])
