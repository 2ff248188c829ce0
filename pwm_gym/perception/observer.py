"""From an RGB-D view and joint angles to a complete scene (paper, section 3, "Obtaining Complete Point Clouds")."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch

from pwm_gym.completion import Completer
from pwm_gym.errors import PwmGymError, SceneError
from pwm_gym.perception.cleaning import Cleaning, clean
from pwm_gym.perception.frame import Frame
from pwm_gym.perception.furniture import Furniture, furniture_names
from pwm_gym.perception.segmenters import Segmenter
from pwm_gym.perception.tracking import Tracker, TrackingConfig
from pwm_gym.robots import RobotCloud
from pwm_gym.scene import Layout, Scene
from pwm_gym.scene.se3 import matrix_from_pose7, pose7_from_matrix

__all__ = ["Observation", "SceneObserver"]


_SHOWN = 100  # points of an object that the first view did not show, from which on it is completed


@dataclass(frozen=True, eq=False)
class Observation:
    """A scene as it was estimated from one view."""

    scene: Scene
    """What ``env.reset(options={"scene": ...})`` takes; its objects' canonical frames are their completed clouds'."""
    partials: dict[str, np.ndarray]
    """Clean points (m, 3) of the objects that were seen, metres, base frame."""
    errors: dict[str, float]
    """Expected Chamfer distance of each object's completed cloud from its true surface, metres."""
    seconds: dict[str, float]
    """Time of each stage: "robot", "segment", "clean", "complete", "track"."""


class SceneObserver:
    """Estimates complete scenes from views, one episode at a time.

    The first view's objects are completed; in later views their completed clouds are tracked, so that velocities exist
    and identity lasts. What is hidden keeps its last completed cloud, where it was or with what carries it: a hand, or
    the drawer that it lies in. Bodies with joints are known by their canonical clouds (:mod:`.furniture`); an object
    that the first view does not show is taken to stand in their first drawer, until a view shows it.

    Args:
        task: of the scenes, by name.
        layout: of the scenes; its effectors are the robot's links.
        robot: gives the links' poses, and their clouds; None takes the poses that the robot reports (``Frame.links``).
        segmenter: finds the objects.
        completer: completes them.
        clouds: the layout's canonical points (N, 3), of which the links' replace the robot's own: a simulator's. They
            are needed where bodies have joints, and without a robot.
        cleaning: of the depth.
        tracking: thresholds.
        table: height of the table in the base frame, metres, which no completed point is below; None where there is
            none.

    Raises:
        SceneError: the robot lacks a link of the layout, or there are no clouds where they are needed.
    """

    def __init__(
        self,
        task: str,
        layout: Layout,
        robot: RobotCloud | None,
        segmenter: Segmenter,
        completer: Completer,
        *,
        clouds: np.ndarray | None = None,
        cleaning: Cleaning | None = None,
        tracking: TrackingConfig | None = None,
        table: float | None = 0.0,
    ) -> None:
        self._links = [e.name for e in layout if e.driven]
        self.task, self.layout, self.robot, self.table = task, layout, robot, table
        self.segmenter, self.completer, self.cleaning, self.tracking = segmenter, completer, cleaning, tracking
        self._own = self._clouds_of_links(robot, clouds)
        self._places = [] if robot is None else [robot.layout.index(name) for name in self._links]
        known = furniture_names(layout)
        if known and clouds is None:
            raise SceneError(
                f"{', '.join(known)} hang on joints; expected the layout's canonical clouds to know them by"
            )
        self._canonical = {} if clouds is None else {e.name: clouds[e.slice] for e in layout if not e.driven}
        self._furniture = Furniture(layout, self._canonical, tracking)
        self.reset()

    def _clouds_of_links(self, robot: RobotCloud | None, clouds: np.ndarray | None) -> dict[str, np.ndarray]:
        """Link -> canonical points (n, 3)."""
        names = None if robot is None else robot.layout.names
        if names is not None and (missing := [name for name in self._links if name not in names]):
            raise SceneError(f"the robot has no cloud of {', '.join(missing)}; it has {', '.join(names)}")
        if clouds is not None:
            return {name: clouds[self.layout[name].slice] for name in self._links}
        if robot is None:
            raise SceneError("robot=None and clouds=None; expected one of them to tell the links' clouds")
        return {name: robot.clouds[robot.layout[name].slice] for name in self._links}

    def reset(self) -> None:
        """Forget the episode: the next view's objects are completed."""
        self._tracker: Tracker | None = None
        self._completed: dict[str, np.ndarray] = {}
        self._errors: dict[str, float] = {}
        self._unseen: set[str] = set()
        self._joints: deque[np.ndarray] = deque(maxlen=2)
        self._poses: deque[np.ndarray] = deque(maxlen=3)  # the robot's (L, 4, 4), newest first

    def __call__(
        self,
        frame: Frame,
        goal: np.ndarray,
        last_action: np.ndarray | None = None,
        carried: Mapping[str, str] | None = None,
    ) -> Observation:
        """Take in the next view.

        Args:
            frame: the view, with joint angles.
            goal: (G,) of the task.
            last_action: (A,) that led here.
            carried: object -> link, of what is grasped: while it is hidden, it goes with the link.

        Raises:
            SceneError: the frame does not tell where the robot is, or an object is not seen in the first view.
            PwmGymError: what segmenter, cleaning or completer say of the first view.
        """
        seconds: dict[str, float] = {}
        with _timed(seconds, "robot"):
            self._move_robot(frame)
        with _timed(seconds, "segment"):
            masks = self.segmenter(frame)
        with _timed(seconds, "clean"):
            partials = self._partials(frame, masks)
        eye = frame.camera.pose[:3, 3]
        if self._tracker is None:
            with _timed(seconds, "complete"):
                self._tracker = self._begin(partials, eye)
        else:
            with _timed(seconds, "track"):
                self._follow(self._tracker, partials, eye, carried or {})
        scene = self._scene(self._tracker, goal, last_action)
        return Observation(scene, partials, dict(self._errors), seconds)

    def _move_robot(self, frame: Frame) -> None:
        if frame.joints is None:
            raise SceneError("the frame has no joints; expected the robot's joint angles (J,)")
        poses = self._link_poses(frame, frame.joints)
        if not self._poses:
            self._poses.extend([poses] * 2)
            self._joints.append(frame.joints)
        self._poses.appendleft(poses)
        self._joints.appendleft(frame.joints)

    def _link_poses(self, frame: Frame, joints: np.ndarray) -> np.ndarray:
        """The driven links' poses (L, 4, 4): by forward kinematics, or as the robot reports them."""
        if self.robot is not None:
            return self.robot.poses(torch.as_tensor(joints, dtype=torch.float64)).numpy()[self._places]
        if frame.links is None or len(frame.links) != len(self._links):
            found = "no links" if frame.links is None else f"{len(frame.links)} links"
            raise SceneError(f"the frame has {found}; expected the poses (L, 7) of {', '.join(self._links)}")
        return matrix_from_pose7(torch.as_tensor(frame.links)).numpy()

    def _partials(self, frame: Frame, masks: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Clean points of what is in sight; in the first view all must be, but for what a body with joints may hide."""
        first, partials = self._tracker is None, {}
        for name in (e.name for e in self.layout if not e.driven):
            may_hide = self._furniture.hides and name not in self._furniture
            if name not in masks:
                if first and not may_hide:
                    found = ", ".join(masks) or "nothing"
                    raise SceneError(f"{name!r} is not in the first view (found: {found}); expected to see it once")
                continue
            try:
                partials[name] = clean(frame.depth, masks[name], frame.camera, self.cleaning)
            except PwmGymError as error:  # hardly a pixel of it is seen
                if first and not may_hide:
                    raise SceneError(f"{name!r} is hardly seen in the first view: {error}") from error
        return partials

    def _begin(self, partials: Mapping[str, np.ndarray], eye: np.ndarray) -> Tracker:
        """Find the bodies with joints, and complete all other objects."""
        self._furniture.find(partials, eye)
        poses = {}
        for name in (e.name for e in self.layout if not e.driven and e.name not in self._furniture):
            if name in partials:
                poses[name] = self._complete(name, partials[name], eye)
            else:
                poses[name] = self._furniture.inside(self._canonical[name])
                self._completed[name] = self._canonical[name].astype(np.float32)
                self._unseen.add(name)
        return Tracker(self._completed, poses, self.tracking)

    def _follow(
        self, tracker: Tracker, partials: Mapping[str, np.ndarray], eye: np.ndarray, carried: Mapping[str, str]
    ) -> None:
        """Take in a later view: joints, then objects, of which some may be seen for the first time."""
        motions = self._motions()
        for name in sorted(self._unseen):
            if len(partials.get(name, ())) >= _SHOWN:
                pose = self._complete(name, partials[name], eye)
                tracker.track(name, self._completed[name], pose)
                self._unseen.discard(name)
        furniture, loose = self._furniture, partials.keys() - self._unseen
        held_by = {n: furniture.around(points.mean(0)) for n, points in tracker.points().items()}
        carriers = {**{n: part for n, part in held_by.items() if part is not None}, **carried}
        furniture.update(partials)
        motions |= {name: furniture.motion(name) for name in furniture.moving}
        views = {name: partials[name] for name in loose if name not in furniture}
        tracker.update(views, eye=eye, carried_by=carriers, motion=motions)

    def _complete(self, name: str, partial: np.ndarray, eye: np.ndarray) -> np.ndarray:
        """Complete an object, and return its pose (4, 4)."""
        done = self.completer(partial, eye, self.layout[name].points)
        points = done.points.astype(np.float64)
        if self.table is not None:
            points[:, 2] = np.maximum(points[:, 2], self.table)
        pose = _upright_frame(points)
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        self._completed[name], self._errors[name] = local.astype(np.float32), done.error
        return pose

    def _motions(self) -> dict[str, np.ndarray]:
        """Motion (4, 4) of each link since the last view, in the base frame."""
        now, before = self._poses[0], self._poses[1]
        names = [e.name for e in self.layout if e.driven]
        return {name: now[i] @ np.linalg.inv(before[i]) for i, name in enumerate(names)}

    def _scene(self, tracker: Tracker, goal: np.ndarray, last_action: np.ndarray | None) -> Scene:
        links = iter(np.stack(self._poses).swapaxes(0, 1))  # (L, 3, 4, 4)
        poses, clouds = [], []
        for e in self.layout:
            if e.driven:
                poses.append(next(links))
                clouds.append(self._own[e.name])
            elif e.name in self._furniture:
                poses.append(self._furniture.history(e.name))
                clouds.append(self._canonical[e.name])
            else:
                poses.append(tracker.history(e.name))
                clouds.append(self._completed[e.name])
        joints = np.stack([self._joints[0], self._joints[0] - self._joints[1]]).astype(np.float32)
        return Scene(
            task=self.task,
            layout=self.layout,
            clouds=np.concatenate(clouds).astype(np.float32),
            poses=pose7_from_matrix(torch.as_tensor(np.stack(poses, 1))).numpy(),
            goal=np.asarray(goal, np.float32),
            joints=joints,
            last_action=last_action,
        )


def _upright_frame(points: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of a canonical frame in the middle of points (n, 3), its axes those of their upright bounding box.

    A box's own axes are found so, up to quarter turns: models have learned from objects whose axes are theirs.
    """
    from trimesh.bounds import oriented_bounds_2D

    to_box, _ = oriented_bounds_2D(points[:, :2])
    yaw = -np.arctan2(to_box[1, 0], to_box[0, 0])
    yaw = (yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4  # the quarter turn that is nearest to none
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = points.mean(0)
    return pose


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    begun = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - begun
