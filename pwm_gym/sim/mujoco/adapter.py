"""Any MuJoCo model as a simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.errors import PwmGymError, SceneError, unknown_name
from pwm_gym.robots.control import Control
from pwm_gym.scene import Scene
from pwm_gym.scene.poses import compose, relative, rotation
from pwm_gym.sim.mujoco.meshes import body_mesh, welded
from pwm_gym.sim.mujoco.mocap import place_mocaps
from pwm_gym.sim.mujoco.parts import sort_parts
from pwm_gym.sim.mujoco.restore import JointSolver, set_free_velocity
from pwm_gym.sim.mujoco.structure import WARNINGS, check_supported, hanging, warned
from pwm_gym.sim.mujoco.worlds import World, XmlWorld
from pwm_gym.sim.protocol import SimOutcome

if TYPE_CHECKING:
    import trimesh

__all__ = ["MujocoSimulator"]

_WORLD = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class MujocoSimulator:
    """A MuJoCo model, one environment, physics only.

    Each control step begins with a cold solver, and positions are read after the step's last instant: the future
    depends on nothing that a scene does not tell. Robots are trees of bodies that an actuator or a mocap body drives,
    and mocap bodies that are entities.
    An entity's frame is its body's, moved onto the axis of the hinge on which it hangs where that passes beside it.

    Args:
        world: steps the model.
        bodies: entity name -> body; what is fixed to a body belongs to it.
        judge: tells reward, success and grasp of the present instant; by default there is no reward.
        base: pose (7,) of the public frame in MuJoCo's world, or a body of the model whose frame it is.
        robot: root body of the robot, where it is not what actuators and mocap bodies drive.
        control: what the actions are taken to mean; its size and period are checked against the world's.
        visual: entities whose surface is that of geoms which collide with nothing.
        surfaces: entity name -> surface that is shown in the place of its geoms', in the body's frame (metres).
        placed: entities fixed to the world whose place differs between episodes; a scene tells it.

    Raises:
        UnknownNameError: a body that the model lacks, or a surface or a place of no entity.
        PwmGymError: there is no entity, two are one body, ``control`` is of another size or period, or the model has
            something that is not supported.
    """

    def __init__(
        self,
        world: World,
        bodies: Mapping[str, str],
        judge: Callable[[MujocoSimulator], SimOutcome] | None = None,
        base: Sequence[float] | np.ndarray | str = _WORLD,
        robot: str | None = None,
        control: Control | None = None,
        visual: Sequence[str] = (),
        surfaces: Mapping[str, trimesh.Trimesh] | None = None,
        placed: Sequence[str] = (),
    ) -> None:
        self.world, self.model, self.data = world, world.model, world.data
        self.action_size = world.action_size
        self._bodies = dict(bodies)
        self._judge, self._visual = judge, tuple(visual)
        self._surfaces = dict(surfaces or {})
        self._placed = tuple(placed)
        for name in (*self._surfaces, *self._placed):
            if name not in self._bodies:
                raise unknown_name("entity", name, self._bodies)
        check_supported(self.model)
        if control is not None:
            self._check_control(control)
        self._check_bodies()
        self._ids = np.array([self._find(body) for body in self._bodies.values()])
        entities = {int(k) for k in self._ids}
        for name, body in zip(self._bodies, self._ids, strict=True):
            if name in self._placed and (self.model.body_parentid[body] or self.model.body_jntnum[body]):
                raise PwmGymError(f"entity {name!r} is not fixed to the world; only such entities can be placed")
        self._offsets = np.stack([hanging(self.model, int(k), entities).offset for k in self._ids])  # (E, 3)
        self._offset = bool(self._offsets.any())
        self._groups = {
            name: [number for number, _ in welded(self.model, int(k), entities)]
            for name, k in zip(self._bodies, self._ids, strict=True)
        }
        self._parts = sort_parts(self.model, self._numbers(), None if robot is None else self._find(robot))
        self._solver = JointSolver(self.model, self._parts.dofs, tuple(self._parts.articulated.values()))
        self.reset(0)
        self._base = np.array(self._world_pose(self._find(base)) if isinstance(base, str) else base, float)
        self._base_matrix = rotation(self._base).as_matrix()
        self._base_product = _product_with_inverse(self._base[3:])

    @property
    def env(self) -> Any:
        """The environment of its own that the world steps; None where it steps its model alone."""
        return getattr(self.world, "env", None)

    @classmethod
    def from_xml(cls, xml: str | Path, bodies: Mapping[str, str], frame_skip: int = 20, **options: Any) -> Self:
        """A simulator of an XML, whose actions span the ranges of its actuators.

        Args:
            xml: path of the file, or its text.
            bodies: entity name -> body.
            frame_skip: MuJoCo's steps in one control step.
            options: of the simulator; ``act``, ``action_size`` and ``start`` are those of :class:`XmlWorld`.
        """
        own = {name: options.pop(name) for name in ("act", "action_size", "start") if name in options}
        return cls(XmlWorld(xml, frame_skip=frame_skip, **own), bodies, **options)

    def _check_control(self, control: Control) -> None:
        world = self.world
        if control.size != world.action_size:
            raise PwmGymError(f"the world takes actions of {world.action_size} components; expected {control.size}")
        if abs(control.period - world.period) > 1e-6:
            raise PwmGymError(
                f"the world has a control period of {world.period:.4f} s; expected {control.period:.4f} s"
            )

    # What the model is made of ------------------------------------------------------------------------------------

    def _find(self, body: str) -> int:
        names = [self.model.body(k).name for k in range(self.model.nbody)]
        if body not in names:
            raise unknown_name("body of the model", body, names)
        return names.index(body)

    def _check_bodies(self) -> None:
        if not self._bodies:
            raise PwmGymError("bodies={}; expected entity -> body, of one at least")
        owner: dict[str, str] = {}
        for name, body in self._bodies.items():
            if body in owner:
                raise PwmGymError(f"entities {owner[body]!r} and {name!r} are both body {body!r}; expected one of them")
            owner[body] = name

    def _numbers(self) -> dict[str, int]:
        """Entity name -> MuJoCo's number of its body."""
        return dict(zip(self._bodies, self._ids.tolist(), strict=True))

    @property
    def bodies(self) -> dict[str, str]:
        """Entity name -> body."""
        return dict(self._bodies)

    @property
    def links(self) -> frozenset[str]:
        """Names of the entities that the robot drives."""
        return self._parts.links

    @property
    def robot_bodies(self) -> frozenset[int]:
        """MuJoCo's numbers of the bodies that are the robot, whether or not they are entities."""
        return self._parts.robot

    @property
    def base(self) -> np.ndarray:
        """Pose (7,) of the public frame in MuJoCo's world."""
        return self._base.copy()

    def body_id(self, name: str) -> int:
        """MuJoCo's number of an entity's body."""
        return int(self._ids[[*self._bodies].index(name)])

    def geoms(self) -> frozenset[int]:
        """MuJoCo's numbers of the geoms that belong to entities."""
        owned = [body for group in self._groups.values() for body in group]
        return frozenset(np.flatnonzero(np.isin(self.model.geom_bodyid, owned)).tolist())

    def meshes(self) -> dict[str, trimesh.Trimesh]:
        """Surfaces of the entities, in each entity's own frame (metres)."""
        entities = {int(k) for k in self._ids}
        found = {}
        for name, k, offset in zip(self._bodies, self._ids, self._offsets, strict=True):
            mesh = self._surfaces.get(name) or body_mesh(self.model, int(k), entities, name in self._visual)
            found[name] = mesh.copy().apply_translation(-offset) if offset.any() else mesh
        return found

    def assets(self) -> tuple[str, ...]:
        """Name of each entity (E,): what they look like is always the same."""
        return tuple(self._bodies)

    # Where episodes start -----------------------------------------------------------------------------------------

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``."""
        self.world.reset(int(seed))
        self._forward()

    def restore(self, scene: Scene, rebuild: bool = True) -> None:
        """Put robot, objects and goal where ``scene`` says, with the velocities that its poses and joints tell.

        Args:
            scene: to start from.
            rebuild: makes no difference: MuJoCo's future depends on its state alone.

        Raises:
            SceneError: the scene has no joint positions, those of another robot, other entities, or an articulated
                part where its joints do not bring it.
        """
        joints = self._check_scene(scene)
        poses = np.array([[compose(self._base, pose) for pose in step] for step in scene.poses])  # (3, E, 7)
        poses[..., :3] -= self._shifts(poses[..., 3:])
        self.world.clear()
        for name in self._placed:
            row = [*self._bodies].index(name)
            self.model.body_pos[self._ids[row]], self.model.body_quat[self._ids[row]] = np.split(poses[0, row], [3])
        self._set_articulated(joints, poses)
        self._set_positions(joints[0], poses[0])
        self._set_velocities(joints[1], poses)
        place_mocaps(self.model, self.data, told=self._parts.mocaps.values())
        self.world.set_goal(self._outward(np.asarray(scene.goal, float)))
        self._forward()

    def _check_scene(self, scene: Scene) -> np.ndarray:
        """The scene's joint positions and velocities (2, J)."""
        if scene.layout.names != tuple(self._bodies):
            raise SceneError(f"the scene's entities are {scene.layout.names}; expected {tuple(self._bodies)}")
        if scene.joints is None:
            raise SceneError("scene.joints is None; a simulator starts only from a scene with joint positions")
        if scene.joints.shape != (2, len(self._parts.joints)):
            raise SceneError(
                f"scene.joints has {scene.joints.shape[-1]} joints; the simulator's robot has {len(self._parts.joints)}"
            )
        return np.asarray(scene.joints, float)

    def _set_positions(self, joints: np.ndarray, poses: np.ndarray) -> None:
        """Put the robot at joint positions (J,), free and mocap bodies at theirs of all poses (E, 7) in the world."""
        self.data.qpos[self.model.jnt_qposadr[self._parts.joints]] = joints
        for name, joint in self._parts.free.items():
            address = int(self.model.jnt_qposadr[joint])
            self.data.qpos[address : address + 7] = poses[[*self._bodies].index(name)]
        for name, mocap in self._parts.mocaps.items():
            place, turn = np.split(poses[[*self._bodies].index(name)], [3])
            self.data.mocap_pos[mocap] = place
            self.data.mocap_quat[mocap] = turn

    def _set_velocities(self, joints: np.ndarray, poses: np.ndarray) -> None:
        """Give the robot joint velocities (J,) a step, and free bodies those that poses (3, E, 7) tell."""
        self.data.qvel[self.model.jnt_dofadr[self._parts.joints]] = joints / self.world.period
        for name, joint in self._parts.free.items():
            own = poses[:, [*self._bodies].index(name)]
            set_free_velocity(self.data, int(self.model.jnt_dofadr[joint]), own, 1.0 / self.world.period)

    def _set_articulated(self, joints: np.ndarray, poses: np.ndarray) -> None:
        """Place articulated entities by poses (3, E, 7) in the world, with the velocities that these tell.

        They may hang on free bodies, so that these and the robot, with joints (2, J), go first where they were. Joints
        that move no entity are solved for, too: a loop may bind them to the robot.
        """
        if not len(self._solver.dofs):
            return
        own = [[*self._bodies].index(name) for name in self._parts.articulated]
        self._set_positions(joints[0] - joints[1], poses[1])
        self._solver.solve(self.data, poses[1, own])
        before = self.data.qpos.copy()
        self._set_positions(joints[0], poses[0])
        self._solver.solve(self.data, poses[0, own])
        velocities = self._solver.velocities(self.data, before, 1.0 / self.world.period)
        self.data.qvel[self._solver.dofs] = velocities

    def place(self, name: str, pose: np.ndarray) -> None:
        """Put a free body at rest at a pose (7,) in the base's frame.

        Raises:
            UnknownNameError: there is no such entity.
            SceneError: it is no free body, and no joints of its own bring it there.
        """
        if name not in self._bodies:
            raise unknown_name("entity", name, self._bodies)
        place = compose(self._base, pose)
        if name in self._parts.free and name not in self.links:
            self._rest(self._parts.free[name], place)
        elif name in self._parts.articulated:
            self._hang(name, place)
        else:
            raise SceneError(f"{name!r} is no free body; only free bodies can be placed")
        self._forward()

    def _rest(self, joint: int, pose: np.ndarray) -> None:
        """Put the body of a free joint at a pose (7,) in the world, at rest."""
        position = int(self.model.jnt_qposadr[joint])
        velocity = int(self.model.jnt_dofadr[joint])
        self.data.qpos[position : position + 7] = pose
        self.data.qvel[velocity : velocity + 6] = 0.0

    def _hang(self, name: str, pose: np.ndarray) -> None:
        """Bring an articulated body to a pose (7,) in the world, at rest, with all others where they are."""
        poses = np.array([self._world_pose(body) for body in self._parts.articulated.values()])
        poses[[*self._parts.articulated].index(name)] = pose
        self._solver.solve(self.data, poses)
        self.data.qvel[self._solver.dofs] = 0.0

    # Steps and what they show -------------------------------------------------------------------------------------

    def step(self, action: np.ndarray) -> SimOutcome:
        """Apply an action (A,) in [-1, 1] for one control step.

        Raises:
            PwmGymError: the action is of another size, a control is no number, or the simulation diverged.
        """
        action = np.asarray(action, dtype=np.float32)
        if action.shape != (self.action_size,):
            raise PwmGymError(f"the action has shape {action.shape}; expected ({self.action_size},)")
        self.data.qacc_warmstart[:] = 0.0
        self.world.step(action)
        self._check_finite()
        self._forward()
        return self.outcome()

    def _forward(self) -> None:
        """Bring all that depends on positions and velocities up to date with them."""
        import mujoco

        mujoco.mj_forward(self.model, self.data)

    def _check_finite(self) -> None:
        import mujoco

        for name in WARNINGS:
            warning = self.data.warning[int(getattr(mujoco.mjtWarning, name))]
            if warning.number:
                warning.number = 0
                raise PwmGymError(warned(self.model, name, int(warning.lastinfo)))

    def outcome(self) -> SimOutcome:
        """Reward, success and grasp of the present instant."""
        return SimOutcome(0.0, False, False) if self._judge is None else self._judge(self)

    def poses(self, data: Any = None) -> np.ndarray:
        """Entity poses (E, 7) in the base's frame, at present or as other ``data`` of the model has them."""
        data = self.data if data is None else data
        places = data.xpos[self._ids] + self._shifts(data.xquat[self._ids])
        places = (places - self._base[:3]) @ self._base_matrix
        turns = data.xquat[self._ids] @ self._base_product.T
        turns[turns[:, 0] < 0.0] *= -1.0
        return np.concatenate([places, turns], -1)

    def pose(self, name: str) -> np.ndarray:
        """Pose (7,) of one entity in the base's frame."""
        row = [*self._bodies].index(name)
        pose = self._world_pose(int(self._ids[row]))
        pose[:3] += rotation(pose).apply(self._offsets[row])
        return relative(self._base, pose[None])[0]

    def _shifts(self, turns: np.ndarray) -> np.ndarray:
        """Way (..., E, 3) from the bodies' origins to the entities', in the world, of turns (..., E, 4)."""
        if not self._offset:
            return np.zeros((*turns.shape[:-1], 3))
        flat = Rotation.from_quat(turns.reshape(-1, 4), scalar_first=True)
        offsets = np.tile(self._offsets, (len(flat) // len(self._offsets), 1))
        return flat.apply(offsets).reshape(*turns.shape[:-1], 3)

    def _world_pose(self, body: int) -> np.ndarray:
        return np.concatenate([self.data.xpos[body], self.data.xquat[body]])

    def touching(self, first: str, second: str) -> bool:
        """Whether two entities are in contact."""
        for name in (first, second):
            if name not in self._bodies:
                raise unknown_name("entity", name, self._bodies)
        pairs = self.model.geom_bodyid[self.data.contact.geom]  # (C, 2)
        one, other = (np.isin(pairs, self._groups[name]) for name in (first, second))
        return bool(((one[:, 0] & other[:, 1]) | (one[:, 1] & other[:, 0])).any())

    def goal(self) -> np.ndarray:
        """Goal (G,), float32; a position is in the base's frame, metres."""
        goal = self.world.goal()
        if goal.shape == (3,):
            goal = rotation(self._base).inv().apply(goal - self._base[:3])
        return goal.astype(np.float32)

    def _outward(self, goal: np.ndarray) -> np.ndarray:
        """A goal (G,) as the world has it."""
        return compose(self._base, np.r_[goal, 1, 0, 0, 0])[:3] if goal.shape == (3,) else goal

    def joints(self) -> np.ndarray:
        """Joint positions and velocities (2, J) float32: radians (sliding joints: metres), and these a control step."""
        positions = self.data.qpos[self.model.jnt_qposadr[self._parts.joints]]
        speeds = self.data.qvel[self.model.jnt_dofadr[self._parts.joints]] * self.world.period
        return np.stack([positions, speeds]).astype(np.float32)

    def close(self) -> None:
        """Free the simulator; calling it twice is harmless."""
        self.world.close()


def _product_with_inverse(quaternion: np.ndarray) -> np.ndarray:
    """Matrix (4, 4) that multiplies a quaternion, from the left, by the inverse of a unit ``quaternion`` (4,)."""
    w, x, y, z = quaternion
    return np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])
