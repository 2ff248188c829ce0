"""Scenes that no episode of a task starts from: underway, mirrored; objects in mid-air, stacked, leaning, touching.

An object that starts at rest in mid-air falls freely until it touches something: its motion labels itself.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from pwm_gym.collection.extents import Extents
from pwm_gym.errors import SceneError
from pwm_gym.scene import Layout, Scene
from pwm_gym.scene.poses import mirrored, turn_between
from pwm_gym.sim import PlacesBodies, Simulator
from pwm_gym.tasks import Task

__all__ = ["LONG", "mirror", "perturb", "run_ahead"]

LONG = 120  # steps of an expert that make a task a long one

_GAP = 5e-4  # metres left between what is put in contact, so that nothing starts inside anything
_BESIDE_HAND = 0.15  # metres from the tool at which the hand and its fingers are out of the way
_WIDEST = 0.07  # metres: what fits between open fingers
_APART = 1e-3  # metres and radians by which a mirrored body may be off


def run_ahead(simulator: Simulator, task: Task, rng: np.random.Generator) -> np.ndarray | None:
    """Let the expert act for a number of steps, drawn up to a demonstration's mean length.

    Returns:
        Its last action (A,), float32; None where no step was drawn.
    """
    ahead = int(rng.integers(task.expert_steps))
    if ahead == 0:
        return None
    expert = task.expert(rng)
    for _ in range(ahead):
        action = expert.act(simulator.poses(), simulator.goal(), simulator.assets())
        last = np.clip(np.asarray(action, np.float32), -1.0, 1.0)
        simulator.step(last)
    return last


def mirror(simulator: Simulator, task: Task) -> None:
    """Put all that the robot does not drive where a mirror between its left and its right shows it; the goal stays.

    A cabinet that all episodes have on one side teaches a model how the arm pulls there alone.

    Raises:
        SceneError: the simulator cannot start so, such as where a door's hinge would be on its other side.
    """
    poses = simulator.poses()
    still = [i for i, e in enumerate(task.layout) if not e.driven]
    poses[still] = mirrored(poses[still])
    clouds = np.zeros((task.layout.points, 3), np.float32)  # simulators have their own
    history = np.repeat(poses[None], 3, 0)
    scene = Scene(
        task.name, task.layout, clouds, history, simulator.goal(), simulator.joints(), assets=simulator.assets()
    )
    simulator.restore(scene, rebuild=False)
    found = simulator.poses()
    for i in still:
        if np.linalg.norm(found[i, :3] - poses[i, :3]) > _APART or turn_between(poses[i], found[i]) > _APART:
            name = task.layout.names[i]
            raise SceneError(f"{task.name} cannot be mirrored: {name!r} would be at {poses[i]}, and is at {found[i]}")


def perturb(
    simulator: Simulator,
    layout: Layout,
    rng: np.random.Generator,
    extents: Extents,
    tool: Callable[[np.ndarray], np.ndarray] | None = None,
) -> None:
    """Move one loose object of the scene to where no episode starts; nothing where the simulator cannot do so.

    Args:
        simulator: whose scene is changed.
        layout: the scene's entities.
        rng: source of all the randomness.
        extents: the entities' boxes.
        tool: poses (E, 7) -> tool centre pose (7,), if the robot has one.
    """
    loose = [layout.names[i] for i in layout.loose]
    if not loose or not isinstance(simulator, PlacesBodies):
        return
    name = str(rng.choice(loose))
    others = [other for other in loose if other != name]
    poses = dict(zip(layout.names, simulator.poses(), strict=True))
    hand = None if tool is None else tool(simulator.poses())
    makers: list[Callable[[], np.ndarray]] = [lambda: _in_air(name, poses, others, hand, extents, rng)]
    makers.append(lambda: _tipped(name, poses, extents, rng))
    if hand is not None and 2 * extents.radius(name) < _WIDEST * 3**0.5:
        makers.append(lambda: _between_fingers(hand, rng))
    if others:
        other = str(rng.choice(others))
        makers += 2 * [lambda: _stacked(name, other, poses, extents, rng)]
        makers.append(lambda: _against(name, other, poses, extents, rng))
    simulator.place(name, makers[rng.integers(len(makers))]())


def _in_air(
    name: str,
    poses: dict[str, np.ndarray],
    others: list[str],
    hand: np.ndarray | None,
    extents: Extents,
    rng: np.random.Generator,
) -> np.ndarray:
    """Pose (7,) up to 20 cm above where the object is, above the other objects and below or beside the hand."""
    ground, _ = extents.height(name, poses[name])
    pose = poses[name].copy()
    pose[:2] += rng.normal(0.0, 0.06, 2)
    if rng.random() < 0.7:
        pose[3:] = _random_turn(rng)
    radius = extents.radius(name)
    floor = ground
    for other in others:
        if np.linalg.norm(poses[other][:2] - pose[:2]) < radius + extents.radius(other):
            floor = max(floor, extents.height(other, poses[other])[1])
    ceiling = floor + 0.2
    if hand is not None and np.linalg.norm(hand[:2] - pose[:2]) < _BESIDE_HAND + radius:
        ceiling = min(ceiling, hand[2] - 0.02 - 2 * radius)
    lowest = rng.uniform(floor + _GAP, max(ceiling, floor + 2 * _GAP))
    return _set_down(name, pose, lowest, extents)


def _tipped(name: str, poses: dict[str, np.ndarray], extents: Extents, rng: np.random.Generator) -> np.ndarray:
    """Pose (7,) on an edge or a corner where the object is: it topples."""
    pose = poses[name].copy()
    pose[3:] = _random_turn(rng)
    return _set_down(name, pose, extents.height(name, poses[name])[0] + _GAP, extents)


def _between_fingers(hand: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pose (7,) in mid-air between the open fingers, along which it is turned."""
    pose = hand.copy()
    axis = Rotation.from_quat(hand[3:], scalar_first=True)
    pose[:3] += axis.apply(rng.normal(0.0, [0.006, 0.003, 0.006]))
    pose[3:] = (axis * Rotation.from_rotvec(rng.normal(0.0, 0.05, 3))).as_quat(scalar_first=True)
    return pose


def _stacked(
    name: str, other: str, poses: dict[str, np.ndarray], extents: Extents, rng: np.random.Generator
) -> np.ndarray:
    """Pose (7,) on top of the other object: off its middle by anything up to where it falls."""
    pose = poses[name].copy()
    _, top = extents.height(other, poses[other])
    width = extents.reach(other, poses[other], np.array([1.0, 0.0, 0.0]))
    pose[:2] = poses[other][:2] + rng.normal(0.0, 0.4 * width, 2)
    pose[3:] = (_about_z(rng.uniform(-np.pi, np.pi)) * _rotation(pose)).as_quat(scalar_first=True)
    return _set_down(name, pose, top + _GAP, extents)


def _against(
    name: str, other: str, poses: dict[str, np.ndarray], extents: Extents, rng: np.random.Generator
) -> np.ndarray:
    """Pose (7,) beside the other object and in touch with it, on the same ground."""
    pose = poses[name].copy()
    ground, _ = extents.height(name, pose)
    angle = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.5:  # side on side
        pose[3:] = poses[other][3:]
        angle = Rotation.from_quat(pose[3:], scalar_first=True).as_euler("zyx")[0] + rng.integers(4) * np.pi / 2
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    distance = extents.reach(other, poses[other], direction) + extents.reach(name, pose, -direction)
    pose[:2] = poses[other][:2] + (distance + _GAP) * direction[:2]
    pose[:2] += rng.normal(0.0, 0.008) * np.array([-direction[1], direction[0]])
    return _set_down(name, pose, ground + _GAP, extents)


def _set_down(name: str, pose: np.ndarray, lowest: float, extents: Extents) -> np.ndarray:
    """The same pose (7,), its lowest point at height ``lowest``."""
    pose[2] += lowest - extents.height(name, pose)[0]
    return pose


def _random_turn(rng: np.random.Generator) -> np.ndarray:
    return Rotation.random(random_state=rng).as_quat(scalar_first=True)


def _about_z(angle: float) -> Rotation:
    return Rotation.from_rotvec([0.0, 0.0, angle])


def _rotation(pose: np.ndarray) -> Rotation:
    return Rotation.from_quat(pose[3:], scalar_first=True)
