"""ManiSkill tasks as simulators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pwm_gym.errors import SceneError
from pwm_gym.scene import Scene
from pwm_gym.sim.headless import allow_headless
from pwm_gym.sim.protocol import SimOutcome

__all__ = ["ManiSkillSimulator"]

_NO_TIME_LIMIT = 1_000_000  # the package's environments own their limits


class ManiSkillSimulator:
    """A ManiSkill task on the CPU, one environment, physics only.

    Args:
        task: ManiSkill id, such as ``"PickCube-v1"``.
        bodies: entity name -> name of the robot's link or of the scene's actor.
        goal: name of the actor whose position is the goal.
        control_mode: the controller that gives actions their meaning.
    """

    def __init__(
        self,
        task: str,
        bodies: Mapping[str, str],
        goal: str,
        control_mode: str = "pd_ee_delta_pose",
    ) -> None:
        self.env = _make(task, control_mode)
        self._base: Any = self.env.unwrapped
        self._bodies, self._goal_name = dict(bodies), goal
        self._bind()
        self._world = _pose7(self._robot.get_links()[0]._objs[0].entity.pose)  # the base in the simulator's world
        self.action_size = int(np.prod(self.env.action_space.shape))

    def _bind(self) -> None:
        """Find robot, entities and goal in the scene as it has just been built."""
        self._robot, actors = self._base.agent.robot, self._base.scene.actors
        links = {link.name: link for link in self._robot.get_links()}
        self._links = {name for name, body in self._bodies.items() if body in links}
        self._entities = {n: _entity(links[b] if b in links else actors[b]) for n, b in self._bodies.items()}
        self._goal = actors[self._goal_name]

    def _rebuild(self, seed: int) -> None:
        """Build the scene anew: PhysX orders contacts by what happened before, which ends in millimetres."""
        self.env.reset(seed=seed, options={"reconfigure": True})
        self._bind()

    def meshes(self) -> dict[str, trimesh.Trimesh]:
        """Collision surfaces, in each entity's own frame (metres)."""
        return {name: _collision_mesh(entity) for name, entity in self._entities.items()}

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``."""
        self._rebuild(int(seed))

    def restore(self, scene: Scene, rebuild: bool = True) -> None:
        """Put robot, objects and goal where ``scene`` says, with the velocities that its poses and joints tell.

        Args:
            scene: to start from.
            rebuild: whether to build the simulator's scene anew (0.1 s), so that nothing of before is left.

        Raises:
            SceneError: the scene has no joint positions, or those of another robot.
        """
        if scene.joints is None:
            raise SceneError("scene.joints is None; a simulator starts only from a scene with joint positions")
        count = self._robot.max_dof
        if scene.joints.shape[-1] != count:
            raise SceneError(f"scene.joints has {scene.joints.shape[-1]} joints; the simulator's robot has {count}")
        import sapien
        import torch

        if rebuild:
            self._rebuild(0)
        self._robot.set_qpos(torch.as_tensor(scene.joints[:1], dtype=torch.float32))
        self._robot.set_qvel(torch.as_tensor(scene.joints[1:] * self._base.control_freq, dtype=torch.float32))
        goal = _compose(self._world, np.r_[scene.goal, 1, 0, 0, 0])
        self._goal._objs[0].set_pose(sapien.Pose(goal[:3], goal[3:]))
        for i, name in enumerate(scene.layout.names):
            if name not in self._links:
                self._place(self._entities[name], scene.poses[:2, i])
        self._base.agent.controller.reset()

    def _place(self, entity: Any, poses: np.ndarray) -> None:
        """Pose and velocity of a free body from its two last base-frame poses (2, 7)."""
        import sapien
        from sapien.physx import PhysxRigidDynamicComponent

        now, before = (_compose(self._world, p) for p in poses)
        entity.set_pose(sapien.Pose(now[:3], now[3:]))
        body = entity.find_component_by_type(PhysxRigidDynamicComponent)
        rate = float(self._base.control_freq)
        turn = _rotation(now) * _rotation(before).inv()
        body.set_linear_velocity((now[:3] - before[:3]) * rate)
        body.set_angular_velocity(turn.as_rotvec() * rate)

    def step(self, action: np.ndarray) -> SimOutcome:
        """Apply an action (A,) in [-1, 1] for one control step."""
        _, reward, _, _, info = self.env.step(np.asarray(action, dtype=np.float32))
        return _outcome(reward, info)

    def outcome(self) -> SimOutcome:
        """Reward, success and grasp of the present instant."""
        import torch

        info = self._base.evaluate()
        action = torch.zeros((1, self.action_size))
        return _outcome(self._base.compute_normalized_dense_reward(obs=None, action=action, info=info), info)

    def assets(self) -> tuple[str, ...]:
        """The entities' own names: they are always the same."""
        return tuple(self._bodies)

    def poses(self) -> np.ndarray:
        """Entity poses (E, 7) in the base's frame."""
        world = np.stack([_pose7(entity.pose) for entity in self._entities.values()])
        return _relative(self._world, world)

    def goal(self) -> np.ndarray:
        """Goal position (3,) in the base's frame, metres."""
        world = _pose7(self._goal._objs[0].pose)
        return _relative(self._world, world[None])[0, :3].astype(np.float32)

    def joints(self) -> np.ndarray:
        """Joint positions and velocities (2, J) float32: radians (fingers: metres), and these a control step."""
        speeds = self._robot.get_qvel()[0].numpy() / self._base.control_freq
        return np.stack([self._robot.get_qpos()[0].numpy(), speeds]).astype(np.float32)

    def close(self) -> None:
        """Free the simulator; calling it twice is harmless."""
        if self.env is not None:
            self.env.close()
            self.env = None


def _make(task: str, control_mode: str) -> Any:
    allow_headless()
    import gymnasium as gym
    import mani_skill.envs  # noqa: F401  (registers the tasks)

    allow_headless()  # once more, for the modules that the import has loaded
    return gym.make(
        task,
        num_envs=1,
        obs_mode="none",
        control_mode=control_mode,
        sim_backend="physx_cpu",
        render_backend="none",
        max_episode_steps=_NO_TIME_LIMIT,
    )


def _outcome(reward: Any, info: Mapping[str, Any]) -> SimOutcome:
    return SimOutcome(float(reward), bool(info["success"]), bool(info["is_grasped"]))


def _entity(struct: Any) -> Any:
    """SAPIEN entity of a ManiSkill link or actor: reading its pose is 25 times faster than ManiSkill's tensors."""
    native = struct._objs[0]
    return native.entity if hasattr(native, "entity") else native


def _pose7(pose: Any) -> np.ndarray:
    return np.concatenate([pose.p, pose.q]).astype(np.float64)


def _rotation(pose7: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose7[..., 3:], scalar_first=True)


def _compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Pose (7,) of ``b`` (7,), given in the frame of ``a`` (7,), in the frame of ``a``'s parent."""
    rotation = _rotation(a)
    return np.r_[a[:3] + rotation.apply(b[:3]), (rotation * _rotation(b)).as_quat(scalar_first=True)]


def _relative(base: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Poses (E, 7) of the frame of ``base`` (7,), given in its parent's."""
    inverse = _rotation(base).inv()
    turned = (inverse * _rotation(poses)).as_quat(canonical=True, scalar_first=True)
    return np.concatenate([inverse.apply(poses[:, :3] - base[:3]), turned], -1)


def _collision_mesh(entity: Any) -> trimesh.Trimesh:
    """Union of an entity's collision shapes in its own frame."""
    from sapien.physx import PhysxRigidBaseComponent

    parts = []
    for component in entity.components:
        if isinstance(component, PhysxRigidBaseComponent):
            for shape in component.collision_shapes:
                mesh = _shape_mesh(shape)
                mesh.apply_transform(shape.local_pose.to_transformation_matrix())
                parts.append(mesh)
    if not parts:
        raise SceneError(f"{entity.name!r} has no collision shape to sample points from")
    return trimesh.util.concatenate(parts)


def _shape_mesh(shape: Any) -> trimesh.Trimesh:
    """Surface of one collision shape; SAPIEN's cylinders and capsules lie along x."""
    kind = type(shape).__name__
    if hasattr(shape, "vertices"):
        return trimesh.Trimesh(shape.vertices * shape.scale, shape.triangles)
    if hasattr(shape, "half_size"):
        return trimesh.creation.box(2 * np.asarray(shape.half_size))
    if kind == "PhysxCollisionShapeSphere":
        return trimesh.creation.icosphere(3, shape.radius)
    if kind == "PhysxCollisionShapeCylinder":
        mesh = trimesh.creation.cylinder(shape.radius, 2 * shape.half_length)
    elif kind == "PhysxCollisionShapeCapsule":
        mesh = trimesh.creation.capsule(2 * shape.half_length, shape.radius)
        mesh.apply_translation(-mesh.bounds.mean(0))
    else:
        raise SceneError(f"collision shape {kind} has no surface to sample points from")
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return mesh
