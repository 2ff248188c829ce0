"""One episode as a page: both worlds move in 3D beside charts, in one file that needs no network."""

from __future__ import annotations

import html
import io
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.viewer.camera import frame_camera
from pwm_gym.viewer.palette import GOAL, PREDICTED, TRUE, entity_colors
from pwm_gym.viewer.twin import TITLES, TwinRecord, timeline

if TYPE_CHECKING:
    from viser import PointCloudHandle, ViserServer

__all__ = ["write_html"]

_PREDICTED, _TRUE, _BOTH = TITLES
_HOLD = 1.0  # seconds that the last step stands still before the playback begins anew
_RIGID = 2e-4  # metres: entities that change their shape by less are sent once, and their poses step by step
_CHARTS = (1100, 170)  # pixels
_POINT = 0.006  # metres: size of a point
_VIEW = (1600, 700)  # pixels: a window that shows all three views


def write_html(record: TwinRecord, path: str | Path, fps: float = 10.0) -> Path:
    """Write the episode as a page that plays it: predicted, both and true side by side, charts along the time slider.

    Points of a rigid entity are sent once and moved by its poses; other points are sent at every step, as 16-bit
    numbers.

    Args:
        record: the episode.
        path: file to write.
        fps: steps a second.

    Raises:
        PwmGymError: the rate is not positive, or viser is not installed.
    """
    if not fps > 0:
        raise PwmGymError(f"fps={fps}; expected a positive rate")
    with _server() as server:
        page = _played(server, record, fps)
    before, end, after = page.rpartition("</body>")
    title = f"<title>{html.escape(record.title or 'pwm_gym')}</title>"
    path = Path(path)
    path.write_text(before.replace("<title>Viser</title>", title) + _panel(record, fps) + end + after, encoding="utf-8")
    return path


@contextmanager
def _server() -> Iterator[ViserServer]:
    """What records a scene: a viser server, seen from this machine alone while it lives."""
    try:
        import viser
    except ModuleNotFoundError as error:
        raise PwmGymError(f"{error}; a page needs viser: pip install 'pwm-gym[viewer]'") from error
    with redirect_stdout(io.StringIO()):  # it greets
        server = viser.ViserServer(host="127.0.0.1", verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def _played(server: ViserServer, record: TwinRecord, fps: float) -> str:
    """viser's own page of the episode."""
    server.scene.configure_default_lights(cast_shadow=False)  # a point casts none
    places = _places(record)
    for name, place in places.items():
        _furnish(server, record, name, place)
    bodies = _bodies(server, record)
    _look(server, record, list(places.values()))
    recorded = server.get_scene_serializer()
    for step in range(1, record.steps):
        recorded.insert_sleep(1.0 / fps)
        for body in bodies:
            body.show(step)
    recorded.insert_sleep(_HOLD)
    return recorded.as_html()


def _extent(record: TwinRecord) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates (3,) of the true world and its goal."""
    points = [np.asarray(record.true).reshape(-1, 3)]
    if record.goal is not None:
        points.append(np.asarray(record.goal)[None, :3])
    every = np.concatenate(points)
    return every.min(0), every.max(0)


def _places(record: TwinRecord) -> dict[str, np.ndarray]:
    """Where each view's origin is put (3,): in a row across the line of sight, so that none hides another."""
    low, high = _extent(record)
    right = np.array([*record.view(100).axes[0][:2], 0.0])
    right /= np.linalg.norm(right)
    apart = 1.25 * np.abs(right) @ (high - low) * right
    return {_PREDICTED: -apart, _BOTH: 0.0 * apart, _TRUE: apart}


def _furnish(server: ViserServer, record: TwinRecord, name: str, place: np.ndarray) -> None:
    """A view's title, floor and goal."""
    low, high = _extent(record)
    middle = 0.5 * (low + high)
    scene = server.scene
    scene.add_frame(f"/{name}", show_axes=False, position=place)
    scene.add_label(f"/{name}/title", name, position=(middle[0], middle[1], high[2] + 0.04), anchor="bottom-center")
    width, depth = 1.2 * (high - low)[:2]
    scene.add_grid(
        f"/{name}/floor", width, depth, cell_size=0.05, section_size=0.25, position=(middle[0], middle[1], 0.0)
    )
    if record.goal is not None:
        scene.add_icosphere(f"/{name}/goal", 0.02, GOAL, opacity=0.5, position=record.goal[:3])


def _look(server: ViserServer, record: TwinRecord, places: Sequence[np.ndarray]) -> None:
    """Where the page's camera starts: all views in sight."""
    corners = np.stack(_extent(record))
    seen = np.concatenate([corners + place for place in places])
    camera = frame_camera(seen, width=_VIEW[0], height=_VIEW[1])
    view = server.initial_camera
    view.position, view.look_at, view.up = camera.eye, camera.target, camera.up
    view.fov = float(np.radians(camera.fov))


def _bodies(server: ViserServer, record: TwinRecord) -> list[_Body]:
    """The entities of every view; the overlay has every second point of each world, so that both colours show."""
    bodies = []
    for parity, (world, points, color) in enumerate(
        ((_PREDICTED, record.predicted, PREDICTED), (_TRUE, record.true, TRUE))
    ):
        colors = entity_colors(record.layout, color)
        for entity in record.layout:
            motion = _Motion.of(np.asarray(points, dtype=np.float64)[:, entity.slice])
            own = colors[entity.slice]
            half = slice(parity, None, 2)
            bodies.append(_Body(server, f"/{world}/{entity.name}", motion, own))
            bodies.append(_Body(server, f"/{_BOTH}/{world}/{entity.name}", motion.some(half), own[half]))
    return bodies


@dataclass(frozen=True, eq=False)
class _Motion:
    """How the points of an entity go."""

    clouds: np.ndarray
    """Points (1, n, 3) in the entity's frame where it is rigid, elsewhere (T, n, 3)."""
    positions: np.ndarray
    """Of that frame (T, 3), metres."""
    turns: np.ndarray
    """Of that frame (T, 4), unit quaternions wxyz."""

    @classmethod
    def of(cls, points: np.ndarray) -> _Motion:
        """The motion of points (T, n, 3): a rigid one where one fits."""
        import roma
        import torch

        positions = points.mean(1)
        centred = points - positions[:, None]
        # The rotation between the first step and each other one that fits the points best (Kabsch).
        first = torch.as_tensor(centred[:1]).expand(len(points), -1, -1)
        rotations, _ = roma.rigid_points_registration(first, torch.as_tensor(centred))
        moved = np.einsum("tij,nj->tni", rotations.numpy(), centred[0])
        if np.abs(moved - centred).max() > _RIGID:
            return cls(centred, positions, np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)))
        turns = roma.rotmat_to_unitquat(rotations).numpy()[:, [3, 0, 1, 2]]
        return cls(centred[:1], positions, turns)

    def some(self, chosen: slice) -> _Motion:
        """The same of some points."""
        return replace(self, clouds=self.clouds[:, chosen])


class _Body:
    """An entity in a view of the page."""

    def __init__(self, server: ViserServer, name: str, motion: _Motion, colors: np.ndarray) -> None:
        self.motion = motion
        self.handle: PointCloudHandle = server.scene.add_point_cloud(
            name,
            motion.clouds[0],
            colors,
            point_size=_POINT,
            point_shape="circle",
            position=motion.positions[0],
            wxyz=motion.turns[0],
        )

    def show(self, step: int) -> None:
        """Move it to where it is at a step."""
        self.handle.position = self.motion.positions[step]
        self.handle.wxyz = self.motion.turns[step]
        if len(self.motion.clouds) > 1:
            self.handle.points = self.motion.clouds[step].astype(np.float16)


def _panel(record: TwinRecord, fps: float) -> str:
    """What stands below the views: title, charts with a cursor, and the present step's values."""
    charts, boxes = timeline(record, *_CHARTS).svg()
    facts = {
        "fps": fps,
        "last": record.steps - 1,
        "seconds": (record.steps - 1) / fps + _HOLD,
        "boxes": boxes,
        "told": [_told(record, step) for step in range(record.steps)],
    }
    template = files("pwm_gym.viewer").joinpath("panel.html").read_text(encoding="utf-8")
    return Template(template).substitute(
        title=html.escape(record.title),
        subtitle=html.escape(record.subtitle),
        charts=charts,
        facts=json.dumps(facts).replace("<", "\\u003c"),
    )


def _told(record: TwinRecord, step: int) -> str:
    """One step in words."""
    parts = [f"error {1000 * record.error[step]:.1f} mm"]
    if record.predicted_reward is not None and record.true_reward is not None:
        parts.append(f"reward {record.predicted_reward[step]:.2f} predicted, {record.true_reward[step]:.2f} true")
    if record.stages:
        parts.append(record.stages[step])
    return "".join(f" · {part}" for part in parts)
