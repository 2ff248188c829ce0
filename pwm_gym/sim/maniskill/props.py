"""Further bodies in a ManiSkill scene: physics alone, without a look."""

from __future__ import annotations

from typing import Any

from pwm_gym.sim.props import Prop

__all__ = ["SceneProps"]

_APART = 1.0  # metres between bodies until they are put in their places
_OUT_OF_REACH = -10.0  # metres


class SceneProps:
    """Adds bodies to the scenes that an environment builds from now on.

    Args:
        env: the unwrapped ManiSkill environment.
    """

    def __init__(self, env: Any) -> None:
        self.wanted: dict[str, Prop] = {}
        """Name of the body -> its shape, in the next scene that is built."""
        self.actors: dict[str, Any] = {}
        """Name of the body -> ManiSkill's actor, in the present scene."""
        self._load = env._load_scene
        env._load_scene = self._load_scene
        self._env = env

    def _load_scene(self, options: dict[str, Any]) -> None:
        self._load(options)
        scene = self._env.scene
        self.actors = {name: _build(scene, name, prop, i) for i, (name, prop) in enumerate(self.wanted.items())}


def _build(scene: Any, name: str, prop: Prop, number: int) -> Any:
    """Actor of a shape, far from everything."""
    import sapien

    builder = scene.create_actor_builder()
    if prop.kind == "box":
        builder.add_box_collision(half_size=[0.5 * side for side in prop.size])
    else:
        upright = sapien.Pose(q=[0.5**0.5, 0.0, 0.5**0.5, 0.0])  # SAPIEN's cylinders lie along x
        builder.add_cylinder_collision(pose=upright, radius=prop.size[0], half_length=0.5 * prop.size[1])
    builder.initial_pose = sapien.Pose([_OUT_OF_REACH, _APART * number, prop.half_height])
    return builder.build(name=f"prop_{name}")
