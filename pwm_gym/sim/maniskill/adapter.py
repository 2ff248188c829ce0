"""A ManiSkill task as a simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import trimesh

from pwm_gym.errors import PwmGymError, SceneError, look_up, unknown_name
from pwm_gym.robots.control import Control
from pwm_gym.scene import Scene
from pwm_gym.scene.poses import compose, relative, rotation
from pwm_gym.sim.maniskill.articulation import articulated_links, restore_articulations
from pwm_gym.sim.maniskill.garbage import seldom_collected
from pwm_gym.sim.maniskill.headless import allow_headless
from pwm_gym.sim.maniskill.meshes import collision_mesh
from pwm_gym.sim.maniskill.poses import pose7
from pwm_gym.sim.maniskill.props import SceneProps
from pwm_gym.sim.props import Prop, get_prop
from pwm_gym.sim.protocol import SimOutcome

__all__ = ["AssetChoice", "HoldsArms", "ManiSkillSimulator"]

_NO_TIME_LIMIT = 1_000_000  # the package's environments own their limits
_GRASP_KEY = "is_grasped"  # what most of ManiSkill's tasks call it in their info


class AssetChoice(Protocol):
    """How a ManiSkill task chooses assets, where its objects differ between episodes."""

    def force(self, env: Any, assets: Mapping[str, str] | None) -> None:
        """Make the next scene of these assets.

        Args:
            env: the unwrapped ManiSkill environment.
            assets: entity -> asset; None leaves the choice to the seed.
        """

    def names(self, env: Any) -> Mapping[str, str]:
        """Entity -> asset in the present scene; entities whose asset is always the same may be left out."""


@runtime_checkable
class HoldsArms(Protocol):
    """A controller that leaves an arm where it is when its target is out of reach."""

    holding: tuple[str, ...]
    """Names of those that it left in the last step."""


class ManiSkillSimulator:
    """A ManiSkill task on the CPU, one environment, physics only.

    Args:
        task: ManiSkill id, such as ``"PickCube-v1"``.
        bodies: entity name -> name of the robot's link, of the scene's actor or of an articulated object's link
            (``"cabinet/drawer"``), or a function that finds it in the unwrapped environment (for actors whose name
            depends on the episode).
        goal: name of the actor whose position is the goal; None if the task has no goal.
        control_mode: the controller that gives actions their meaning.
        control: what the actions are taken to mean; its size and period are checked against ManiSkill's.
        robot_uids: the robot, where it is not the task's default.
        grasped: what ``SimOutcome.grasped`` is told by: a key of ManiSkill's info, or an entity, which the robot's own
            ``is_grasping`` is asked about. None: ``info["is_grasped"]`` where the task has it, otherwise False.
        assets: how the task chooses assets, where its objects differ between episodes.
        joint_names: the robot's joints in the order of scenes' joint vectors; SAPIEN's own where it is None.

    Raises:
        PwmGymError: ``control`` is of another size or period than ManiSkill's controller.
        UnknownNameError: a link, a joint or an actor that the task lacks.
    """

    def __init__(
        self,
        task: str,
        bodies: Mapping[str, str | Callable[[Any], Any]],
        goal: str | None = None,
        control_mode: str = "pd_ee_delta_pose",
        control: Control | None = None,
        robot_uids: str | None = None,
        grasped: str | None = None,
        assets: AssetChoice | None = None,
        joint_names: Sequence[str] | None = None,
    ) -> None:
        with seldom_collected():
            self.env = _make(task, control_mode, robot_uids)
        self._base: Any = self.env.unwrapped
        self._task = task
        self._bodies = dict(bodies)
        self._goal_name = goal
        self._grasp_name = grasped
        self._asset_choice = assets
        self._joint_names = joint_names
        self._props = SceneProps(self._base)
        self.action_size = int(np.prod(self.env.action_space.shape))
        if control is not None:
            self._check_control(control)
        self._bind()
        self._world = pose7(self._robot.get_links()[0]._objs[0].entity.pose)  # the base in the simulator's world

    def _check_control(self, control: Control) -> None:
        if control.size != self.action_size:
            raise PwmGymError(f"{self._task} takes actions of {self.action_size} components; expected {control.size}")
        period = 1.0 / self._base.control_freq
        if abs(period - control.period) > 1e-6:
            raise PwmGymError(f"{self._task} has a control period of {period:.4f} s; expected {control.period:.4f} s")

    # The scene as built -------------------------------------------------------------------------------------------

    def _bind(self) -> None:
        """Find robot, entities and goal in the scene as it has just been built."""
        self._robot = self._base.agent.robot
        self._joint_order = self._find_joints()
        links = {link.name: link for link in self._robot.get_links()}
        actors = self._base.scene.actors
        known = {**actors, **articulated_links(self._base.scene, self._robot), **links}
        self._structs = {name: self._find(body, known) for name, body in self._bodies.items()}
        self._structs.update(self._props.actors)
        self._entities = {name: _entity(struct) for name, struct in self._structs.items()}
        self._links = {name for name, body in self._bodies.items() if isinstance(body, str) and body in links}
        self._articulated = {
            name: struct._objs[0]
            for name, struct in self._structs.items()
            if getattr(struct, "articulation", self._robot) is not self._robot
        }
        self._goal = None if self._goal_name is None else self._find(self._goal_name, actors)._objs[0]

    def _find_joints(self) -> list[int]:
        """SAPIEN's place of each component of a joint vector."""
        known = {joint.name: k for k, joint in enumerate(self._robot.get_active_joints())}
        names = known if self._joint_names is None else self._joint_names
        return [look_up(f"joint of {self._task}", name, known) for name in names]

    def _find(self, body: str | Callable[[Any], Any], known: Mapping[str, Any]) -> Any:
        if not isinstance(body, str):
            return body(self._base)
        if body not in known:
            raise unknown_name(f"body of {self._task}", body, known)
        return known[body]

    def _rebuild(
        self, seed: int, assets: Mapping[str, str] | None = None, props: Mapping[str, Prop] | None = None
    ) -> None:
        """Build the scene anew: PhysX orders contacts by what happened before, which ends in millimetres."""
        self._props.wanted = dict(props or {})
        if self._asset_choice is not None:
            self._asset_choice.force(self._base, assets)
        with seldom_collected():
            self.env.reset(seed=seed, options={"reconfigure": True})
        self._bind()

    def meshes(self) -> dict[str, trimesh.Trimesh]:
        """Collision surfaces of this episode's entities, in each entity's own frame (metres)."""
        return {name: collision_mesh(entity, united=name not in self._links) for name, entity in self._entities.items()}

    def assets(self) -> tuple[str, ...]:
        """Name of each entity's asset in this episode (E,)."""
        chosen = {} if self._asset_choice is None else dict(self._asset_choice.names(self._base))
        chosen.update({name: prop.name for name, prop in self._props.wanted.items()})
        return tuple(chosen.get(name, name) for name in self._entities)

    # Where episodes start -----------------------------------------------------------------------------------------

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``, which chooses the assets, too."""
        self._rebuild(int(seed))

    def restore(self, scene: Scene, rebuild: bool = True) -> None:
        """Put robot, objects and goal where ``scene`` says, with the velocities that its poses and joints tell.

        The controller starts from there, as after a reset: what it was asked for before is not part of a scene. A
        scene that names no assets is of those of the present episode.

        Free entities after the task's own are further bodies: their assets (or else their names) are those of
        :data:`pwm_gym.sim.props.PROPS`.

        Args:
            scene: to start from.
            rebuild: whether to build the simulator's scene anew (0.1 s), so that nothing of before is left; done in
                any case where the assets or the further bodies differ.

        Raises:
            SceneError: the scene has no joint positions, those of another robot, entities that the task lacks, or an
                articulated part beyond its joint's limits.
            UnknownNameError: a further body of an unknown shape.
        """
        joints = self._check_scene(scene)
        names, own = scene.layout.names, len(self._bodies)
        further = names[own:]
        assets = scene.assets or (*self.assets()[:own], *further)
        props = {name: get_prop(asset) for name, asset in zip(further, assets[own:], strict=True)}
        if rebuild or assets != self.assets() or names != tuple(self._entities):
            self._rebuild(0, dict(zip(self._bodies, assets[:own], strict=True)), props)
        self._set_robot(joints)
        if self._goal is not None:
            self._set_goal(scene.goal)
        self._set_articulations(scene)
        for i, name in enumerate(scene.layout.names):
            if name not in self._links and name not in self._articulated:
                self._set_body(name, scene.poses[0, i], scene.poses[1, i])
        self._base.agent.controller.reset()

    def _check_scene(self, scene: Scene) -> np.ndarray:
        """The scene's joint positions and velocities (2, J)."""
        if scene.joints is None:
            raise SceneError("scene.joints is None; a simulator starts only from a scene with joint positions")
        count = self._robot.max_dof
        if scene.joints.shape[-1] != count:
            raise SceneError(f"scene.joints has {scene.joints.shape[-1]} joints; the simulator's robot has {count}")
        own = tuple(self._bodies)
        if scene.layout.names[: len(own)] != own:
            raise SceneError(f"the scene's entities are {scene.layout.names}; expected {own}")
        if bound := [e.name for e in scene.layout.entities[len(own) :] if not e.loose]:
            raise SceneError(f"the scene's further entities {', '.join(bound)} are not free; expected free ones alone")
        return scene.joints

    def _set_robot(self, joints: np.ndarray) -> None:
        """Joint positions and velocities a step (2, J); the motors hold them until an action says otherwise."""
        import torch

        sorted_joints = np.empty_like(joints)
        sorted_joints[:, self._joint_order] = joints
        positions = torch.as_tensor(sorted_joints[:1], dtype=torch.float32)
        self._robot.set_qpos(positions)
        self._robot.set_qvel(torch.as_tensor(sorted_joints[1:] * self._base.control_freq, dtype=torch.float32))
        self._robot.set_joint_drive_targets(positions, self._robot.active_joints)

    def _set_articulations(self, scene: Scene) -> None:
        """Place articulated objects by the poses of their links, with the velocities that these tell."""
        names = scene.layout.names
        now, before = (
            {name: compose(self._world, scene.poses[k, names.index(name)]) for name in self._articulated}
            for k in (0, 1)
        )
        restore_articulations(self._articulated, now, before, float(self._base.control_freq))

    def _set_goal(self, goal: np.ndarray) -> None:
        import sapien

        assert self._goal is not None
        pose = compose(self._world, np.r_[goal, 1, 0, 0, 0])
        self._goal.set_pose(sapien.Pose(pose[:3], pose[3:]))

    def place(self, name: str, pose: np.ndarray) -> None:
        """Put a free body at rest at a pose (7,) in the base's frame.

        Raises:
            UnknownNameError: there is no such body.
            SceneError: it is a link of the robot or of an articulated object.
        """
        if name not in self._entities:
            raise unknown_name("entity", name, self._entities)
        if name in self._links or name in self._articulated:
            owner = "the robot" if name in self._links else "an articulated object"
            raise SceneError(f"{name!r} is a link of {owner}; only free bodies can be placed")
        self._set_body(name, pose, pose)

    def _set_body(self, name: str, pose: np.ndarray, before: np.ndarray) -> None:
        """Pose and velocity of a free body from its base-frame poses (7,) now and one step before."""
        import sapien
        from sapien.physx import PhysxRigidDynamicComponent

        entity = self._entities[name]
        now, last = compose(self._world, pose), compose(self._world, before)
        entity.set_pose(sapien.Pose(now[:3], now[3:]))
        body = entity.find_component_by_type(PhysxRigidDynamicComponent)
        if body is None or body.kinematic:
            return
        rate = float(self._base.control_freq)
        turn = rotation(now) * rotation(last).inv()
        body.set_linear_velocity((now[:3] - last[:3]) * rate)
        body.set_angular_velocity(turn.as_rotvec() * rate)

    # Steps and what they show -------------------------------------------------------------------------------------

    def step(self, action: np.ndarray) -> SimOutcome:
        """Apply an action (A,) in [-1, 1] for one control step."""
        _, reward, _, _, info = self.env.step(np.asarray(action, dtype=np.float32))
        return self._outcome(reward, info)

    def outcome(self) -> SimOutcome:
        """Reward, success and grasp of the present instant."""
        import torch

        info = self._base.evaluate()
        action = torch.zeros((1, self.action_size))
        return self._outcome(self._base.compute_normalized_dense_reward(obs=None, action=action, info=info), info)

    def _outcome(self, reward: Any, info: Mapping[str, Any]) -> SimOutcome:
        controller = self._base.agent.controller
        holding = controller.holding if isinstance(controller, HoldsArms) else ()
        return SimOutcome(float(reward), bool(info.get("success", False)), self._grasped(info), holding)

    def _grasped(self, info: Mapping[str, Any]) -> bool:
        name = self._grasp_name
        if name is None:
            return bool(info.get(_GRASP_KEY, False))
        if name in self._structs:
            return bool(self._base.agent.is_grasping(self._structs[name]))
        if name not in info:
            raise unknown_name(f"grasp of {self._task}", name, [*info, *self._structs])
        return bool(info[name])

    def poses(self) -> np.ndarray:
        """Entity poses (E, 7) in the base's frame.

        Raises:
            SceneError: the simulation has broken down, and tells a pose that is not finite.
        """
        world = np.stack([pose7(entity.pose) for entity in self._entities.values()])
        if not np.isfinite(world).all():
            lost = next(name for name, pose in zip(self._entities, world, strict=True) if not np.isfinite(pose).all())
            raise SceneError(f"{self._task}: the simulator's pose of {lost!r} is not finite; reset() starts anew")
        return relative(self._world, world)

    def goal(self) -> np.ndarray:
        """Goal position (3,) in the base's frame, metres; (0,) where the task has no goal."""
        if self._goal is None:
            return np.zeros(0, np.float32)
        world = pose7(self._goal.pose)
        return relative(self._world, world[None])[0, :3].astype(np.float32)

    def joints(self) -> np.ndarray:
        """Joint positions and velocities (2, J) float32: radians (fingers: metres), and these a control step."""
        speeds = self._robot.get_qvel()[0].numpy() / self._base.control_freq
        joints = np.stack([self._robot.get_qpos()[0].numpy(), speeds])
        return joints[:, self._joint_order].astype(np.float32)

    def close(self) -> None:
        """Free the simulator; calling it twice is harmless."""
        if self.env is not None:
            with seldom_collected():
                self.env.close()
            self.env = None


def _make(task: str, control_mode: str, robot_uids: str | None) -> Any:
    allow_headless()
    import gymnasium as gym
    import mani_skill.envs  # noqa: F401  (registers the tasks)

    import pwm_gym.sim.maniskill.scenes  # noqa: F401  (registers our own)

    allow_headless()  # once more, for the modules that the import has loaded
    robot: dict[str, Any] = {} if robot_uids is None else {"robot_uids": robot_uids}
    return gym.make(
        task,
        num_envs=1,
        obs_mode="none",
        control_mode=control_mode,
        sim_backend="physx_cpu",
        render_backend="none",
        max_episode_steps=_NO_TIME_LIMIT,
        **robot,
    )


def _entity(struct: Any) -> Any:
    """SAPIEN entity of a ManiSkill link or actor: reading its pose is 25 times faster than ManiSkill's tensors."""
    native = struct._objs[0]
    return native.entity if hasattr(native, "entity") else native
