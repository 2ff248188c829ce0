"""The world model beside its simulator: one figure a step, a GIF, or a contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout
from pwm_gym.viewer.camera import Camera, check_points, frame_camera
from pwm_gym.viewer.labels import INK, MUTED, fit, swatch, text
from pwm_gym.viewer.palette import GOAL, PREDICTED, TRUE, Color, entity_colors
from pwm_gym.viewer.splat import render
from pwm_gym.viewer.timeline import Curve, Panel, Timeline

__all__ = ["TITLES", "TwinRecord", "Views", "timeline", "twin_frame", "write_gif", "write_mp4", "write_png"]

_PAPER: Color = (255, 255, 255)
_MARGIN, _GAP, _HEADER, _CAPTION, _CHART = 28, 16, 76, 30, 190  # pixels
TITLES = ("World model (predicted)", "Simulator (true)", "Overlay")
_GIF_FRAMES = 80
_HOLD = 1.5  # seconds that the last step stands still
_MIN_PANEL = 200  # pixels; titles need it
_MIN_SHEET = 640  # pixels
_NUDGE = 0.008  # metres


@dataclass(frozen=True, eq=False)
class TwinRecord:
    """One episode in both worlds: the same start and the same actions. Metres, base frame.

    Raises:
        PwmGymError: shapes do not fit, or points are not finite (it says how many).
    """

    predicted: np.ndarray
    """Points (T, N, 3) of the world model."""
    true: np.ndarray
    """Points (T, N, 3) of the simulator."""
    layout: Layout
    """The entities of the N points."""
    error: np.ndarray
    """Chamfer distance (T,) between the two clouds, metres."""
    goal: np.ndarray | None = None
    """Goal position (3,), or None."""
    predicted_reward: np.ndarray | None = None
    """Reward (T,) in the world model, or None."""
    true_reward: np.ndarray | None = None
    """Reward (T,) in the simulator, or None."""
    title: str = ""
    """The figure's heading."""
    subtitle: str = ""
    """A second, smaller line."""
    stages: tuple[str, ...] = ()
    """What the planner is at in each step (T,), where its task is a sequence of stages."""
    camera: Camera | None = field(default=None)
    """The view; None fits one to the true trajectory."""

    def __post_init__(self) -> None:
        """Check shapes and finiteness."""
        shape = np.shape(self.true)
        if len(shape) != 3 or shape[0] < 1 or shape[1:] != (self.layout.points, 3):
            raise PwmGymError(f"true has shape {shape}; expected (T, {self.layout.points}, 3) with T >= 1")
        if np.shape(self.predicted) != shape:
            raise PwmGymError(f"predicted has shape {np.shape(self.predicted)}; expected {shape}")
        check_points(self.predicted, "predicted points")
        check_points(self.true, "true points")
        if self.stages and len(self.stages) != shape[0]:
            raise PwmGymError(f"{len(self.stages)} stages; expected one for each of {shape[0]} steps, or none")
        for name in ("error", "predicted_reward", "true_reward"):
            values = getattr(self, name)
            if values is not None and np.shape(values) != shape[:1]:
                raise PwmGymError(f"{name} has shape {np.shape(values)}; expected {shape[:1]}")
            if values is not None and not np.isfinite(values).all():
                raise PwmGymError(f"{int((~np.isfinite(values)).sum())} of {shape[0]} {name} values are not finite")

    @property
    def steps(self) -> int:
        """Number T of clouds in each world."""
        return len(self.true)

    def view(self, size: int) -> Camera:
        """A square camera of ``size`` pixels on the whole episode."""
        if self.camera is not None:
            eye, target, up, fov = self.camera.eye, self.camera.target, self.camera.up, self.camera.fov
            return Camera(eye, target, up, fov, size, size)
        low, high = (f(np.asarray(self.true), axis=(0, 1)) for f in (np.min, np.max))
        near = np.clip(self.predicted, low - 0.05, high + 0.05)  # a prediction that flies off may leave the image
        clouds = [np.asarray(self.true), near]
        if self.goal is not None:
            clouds.append(np.asarray(self.goal)[:3] + 0.02 * np.array([[-1, -1, -1], [1, 1, 1]]))
        return frame_camera(*clouds, width=size, height=size)


def twin_frame(record: TwinRecord, t: int, panel: int = 336) -> np.ndarray:
    """Figure (H, W, 3) uint8 of step ``t``: predicted, true and both, above the error (and reward) so far.

    Args:
        record: the episode.
        t: step, 0 to T - 1; negative counts from the end.
        panel: side of each of the three views, pixels.
    """
    if not -record.steps <= t < record.steps:
        raise PwmGymError(f"t={t}; the record has steps 0 to {record.steps - 1}")
    return np.asarray(_Figure(record, panel).frame(t % record.steps))


def write_gif(
    record: TwinRecord, path: str | Path, fps: float = 12, stride: int | None = None, panel: int = 288
) -> Path:
    """Write the episode as an endless GIF; returns its path.

    Args:
        record: the episode.
        path: file to write.
        fps: frames per second.
        stride: steps from one frame to the next; None takes as many as keep it within 80 frames.
        panel: side of each of the three views, pixels.
    """
    stride = stride or -(-record.steps // _GIF_FRAMES)
    if stride < 1 or fps <= 0:
        raise PwmGymError(f"stride={stride}, fps={fps}; expected a stride of at least 1 and a positive rate")
    steps = list(range(0, record.steps, stride))
    if steps[-1] != record.steps - 1:
        steps.append(record.steps - 1)
    figure = _Figure(record, panel)
    frames = [figure.frame(t) for t in steps]
    palette = _shared_palette(frames)
    indexed = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    hold = round(1000 * _HOLD)  # the end stands still for a moment
    durations = [round(1000 / fps)] * (len(steps) - 1) + [hold]
    path = Path(path)
    indexed[0].save(path, "GIF", save_all=True, append_images=indexed[1:], duration=durations, loop=0, disposal=1)
    return path


def write_mp4(record: TwinRecord, path: str | Path, fps: float = 12, panel: int = 288) -> Path:
    """Write the episode as a film, every step a frame (H.264, which browsers play); returns its path.

    Args:
        record: the episode.
        path: file to write.
        fps: frames per second.
        panel: side of each of the three views, pixels.

    Raises:
        PwmGymError: the rate is not positive, or imageio-ffmpeg is not installed.
    """
    if not fps > 0:
        raise PwmGymError(f"fps={fps}; expected a positive rate")
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError as error:
        raise PwmGymError(f"{error}; a film needs imageio-ffmpeg: pip install 'pwm-gym[video]'") from error

    figure = _Figure(record, panel)
    size = (figure.width + figure.width % 2, figure.height + figure.height % 2)  # the codec's are even
    path = Path(path)
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=fps, macro_block_size=2, ffmpeg_log_level="error")
    writer.send(None)
    for t in range(record.steps):
        frame = Image.new("RGB", size, _PAPER)
        frame.paste(figure.frame(t))
        held = round(_HOLD * fps) if t == record.steps - 1 else 0
        for _ in range(1 + held):
            writer.send(frame.tobytes())
    writer.close()
    return path


def write_png(record: TwinRecord, path: str | Path, steps: Sequence[int] | None = None, panel: int = 208) -> Path:
    """Write a contact sheet: a column a step, rows predicted, true, both; the error below. Returns its path.

    Args:
        record: the episode.
        path: file to write.
        steps: which steps; None takes five from first to last.
        panel: side of each view, pixels.
    """
    if steps is None:
        steps = np.unique(np.linspace(0, record.steps - 1, 5).round().astype(int)).tolist()
    wrong = [t for t in steps if not 0 <= t < record.steps]
    if wrong or not len(steps):
        raise PwmGymError(f"steps={list(steps)}; expected some of 0 to {record.steps - 1}")
    path = Path(path)
    _contact_sheet(record, list(steps), panel).save(path, "PNG", optimize=True)
    return path


class _Figure:
    """What the frames of one episode share: camera, colours, and all that does not move."""

    def __init__(self, record: TwinRecord, panel: int) -> None:
        if panel < _MIN_PANEL:
            raise PwmGymError(f"panel={panel} pixels; expected at least {_MIN_PANEL}")
        self.record, self.panel = record, panel
        self.views = Views(record, panel)
        self.width = 2 * _MARGIN + 3 * panel + 2 * _GAP
        self.top = _HEADER + _CAPTION
        below = self.top + panel + _GAP
        self.height = below + _CHART + 8
        self.still = Image.new("RGB", (self.width, self.height), _PAPER)
        self._captions()
        self.below = below
        self.charts = timeline(record, self.width - 2 * _MARGIN, _CHART).frames()

    def frame(self, t: int) -> Image.Image:
        """The figure at step ``t``."""
        image = self.still.copy()
        text(image, (self.width - _MARGIN, 34), f"step {t} / {self.record.steps - 1}", 20, INK, "rm")
        if self.record.stages:
            text(image, (self.width - _MARGIN, 56), self.record.stages[t], 14, MUTED, "rm")
        for i in range(3):
            view = self.views.draw(i, t)
            image.paste(view, (_MARGIN + i * (self.panel + _GAP), self.top), _rounded(self.panel))
        image.paste(self.charts.at(t), (_MARGIN, self.below))
        return image

    def _captions(self) -> None:
        """Heading, panel titles with their colours, and panel outlines."""
        _heading(self.still, self.record)
        for i, colors in enumerate(((PREDICTED,), (TRUE,), (PREDICTED, TRUE))):
            left, row = _MARGIN + i * (self.panel + _GAP), self.top - 16
            for color in colors:
                swatch(self.still, (left, row), color, 13)
                left += 17
            text(self.still, (left + 3, row), TITLES[i], 15)
        if self.record.goal is not None:
            end = self.width - _MARGIN
            used = text(self.still, (end, self.top - 16), "goal", 13, MUTED, "rm")
            swatch(self.still, (end - used - 18, self.top - 16), GOAL)


class Views:
    """The three renderings of an episode: predicted (0), true (1), both (2)."""

    def __init__(self, record: TwinRecord, size: int) -> None:
        self.record, self.camera = record, record.view(size)
        self.colors = [entity_colors(record.layout, c) for c in (PREDICTED, TRUE)]
        # Moved along the line of sight, every second point of each world is in front: both colours show where
        # the worlds agree, and a distance across the image shows as an edge of one colour.
        side = np.where(np.arange(record.layout.points) % 2, _NUDGE, -_NUDGE)
        self.nudge = side[:, None] * self.camera.axes[2]

    def draw(self, which: int, t: int) -> Image.Image:
        """One view (0 predicted, 1 true, 2 both) of step ``t``."""
        worlds = [np.asarray(self.record.predicted[t]), np.asarray(self.record.true[t])]
        if which < 2:
            cloud, colors, radius = worlds[which], self.colors[which], 0.0055
        else:
            cloud = np.concatenate([worlds[0] + self.nudge, worlds[1] - self.nudge])
            colors, radius = np.concatenate(self.colors), 0.0042
        return Image.fromarray(render(cloud, colors, self.camera, radius, goal=self.record.goal))


def _heading(image: Image.Image, record: TwinRecord) -> None:
    """Title and subtitle, with room for the step counter at their right."""
    width = image.width - 2 * _MARGIN
    row = 26 if record.subtitle else 34
    text(image, (_MARGIN, row), fit(record.title, 22, width - 150), 22)
    text(image, (_MARGIN, 52), fit(record.subtitle, 14, width - 150), 14, MUTED)


def timeline(record: TwinRecord, width: int, height: int) -> Timeline:
    """The error's chart and, where both rewards are known, the rewards' beside it, so many pixels in all."""
    error = Curve("error", 1000 * np.asarray(record.error, dtype=np.float64), INK)
    panels = [Panel("Chamfer distance (mm)", (error,), unit="mm", from_zero=True)]
    if record.predicted_reward is not None and record.true_reward is not None:
        true = Curve("true", np.asarray(record.true_reward, dtype=np.float64), TRUE)
        predicted = Curve("predicted", np.asarray(record.predicted_reward, dtype=np.float64), PREDICTED)
        panels.append(Panel("Reward", (true, predicted)))
    return Timeline(panels, width, height)


def _rounded(size: int, radius: int = 10) -> Image.Image:
    """Mask of a square with rounded corners."""
    mask = Image.new("L", (4 * size, 4 * size), 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, 4 * size - 1, 4 * size - 1), 4 * radius, fill=255)
    return mask.resize((size, size), Image.Resampling.BOX)


def _contact_sheet(record: TwinRecord, steps: list[int], panel: int) -> Image.Image:
    """The sheet of :func:`write_png`."""
    gutter, gap = 30, 10
    left, top = _MARGIN + gutter, _HEADER + 26
    width = max(left + len(steps) * (panel + gap) - gap + _MARGIN, _MIN_SHEET)
    below = top + 3 * (panel + gap) + 6
    image = Image.new("RGB", (width, below + _CHART + 8), _PAPER)
    _heading(image, record)
    views, mask = Views(record, panel), _rounded(panel)
    for row in range(3):
        label = Image.new("RGB", (panel, 24), _PAPER)
        text(label, (panel / 2, 12), TITLES[row], 14, INK, "mm")
        image.paste(label.rotate(90, expand=True), (_MARGIN, top + row * (panel + gap)))
        for column, t in enumerate(steps):
            place = (left + column * (panel + gap), top + row * (panel + gap))
            image.paste(views.draw(row, t), place, mask)
    for column, t in enumerate(steps):
        told = f"step {t}: {record.stages[t]}" if record.stages else f"step {t}"
        text(image, (left + column * (panel + gap) + panel / 2, top - 14), fit(told, 14, panel), 14, MUTED, "mm")
    image.paste(timeline(record, width - left - _MARGIN, _CHART).marked(steps), (left, below))
    return image


def _shared_palette(frames: list[Image.Image]) -> Image.Image:
    """One palette of 240 colours for all frames, from eight of them."""
    some = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, 8).astype(int))]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * len(some) + 90))
    for i, color in enumerate((PREDICTED, TRUE, GOAL)):  # large enough that the swatches keep their colours
        sheet.paste(color, (0, height * len(some) + 30 * i, width, height * len(some) + 30 * (i + 1)))
    for i, frame in enumerate(some):
        sheet.paste(frame, (0, i * height))
    return sheet.quantize(240, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
