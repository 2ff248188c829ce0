"""Which pixels of a view belong to which entity: simulator ids, masks of the user's own, and a gate on heights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.perception.frame import Frame, check_masks
from pwm_gym.scene import Layout

__all__ = ["HeightGate", "IdSegmenter", "MaskSegmenter", "Segmenter"]


@runtime_checkable
class Segmenter(Protocol):
    """Finds entities in a view."""

    def __call__(self, frame: Frame) -> dict[str, np.ndarray]:
        """Entity name to bool mask (H, W). An entity that was not found is left out: its last cloud stays in use."""
        ...


class IdSegmenter:
    """Reads the ids that a simulator or a ray caster drew, which are indices into the layout.

    Args:
        layout: the entities, in the order of their ids.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    def __call__(self, frame: Frame) -> dict[str, np.ndarray]:
        """Masks of the entities in sight; the table (-1) and nothing (-2) are none.

        Raises:
            PwmGymError: the frame has no ids, or one that the layout has not.
        """
        if frame.segmentation is None:
            raise PwmGymError("the frame has no segmentation; expected (H, W) entity ids (use other masks, or SAM3)")
        if frame.segmentation.max(initial=-1) >= len(self.layout):
            raise PwmGymError(f"id {frame.segmentation.max()} is no entity; the layout has {len(self.layout)}")
        masks = {name: frame.segmentation == index for index, name in enumerate(self.layout.names)}
        return {name: mask for name, mask in masks.items() if mask.any()}


class MaskSegmenter:
    """Masks that come from elsewhere: the user's own tracker, a drawing program, another network.

    Args:
        masks: the same masks for each frame, a function of the frame, or None for those recorded in the frame.
    """

    def __init__(
        self, masks: Mapping[str, np.ndarray] | Callable[[Frame], Mapping[str, np.ndarray]] | None = None
    ) -> None:
        self._masks: Callable[[Frame], Mapping[str, np.ndarray]]
        if masks is None:
            self._masks = _recorded
        elif callable(masks):
            self._masks = masks
        else:
            self._masks = lambda frame: masks

    def __call__(self, frame: Frame) -> dict[str, np.ndarray]:
        """Masks that are not empty.

        Raises:
            PwmGymError: a mask that is not bool (H, W), or a frame without masks where its own are asked for.
        """
        masks = check_masks(self._masks(frame), frame.depth.shape)
        return {name: mask for name, mask in masks.items() if mask.any()}


def _recorded(frame: Frame) -> Mapping[str, np.ndarray]:
    if frame.masks is None:
        raise PwmGymError("the frame has no masks; expected recorded ones, or give MaskSegmenter some")
    return frame.masks


class HeightGate:
    """Drops phantoms: what another segmenter found on the table, below it or high above it.

    Pixels whose points lie outside the two heights, or whose depth was not measured, leave their mask; a mask of whose
    measured pixels fewer than ``share`` remain is dropped whole, since most of it was something else.

    Args:
        segmenter: finds the masks.
        low: least height, metres above the table (z of the base's frame). The default trims what spills onto the
            table, and with it the foot of each object; one that is not much thicker needs less.
        high: greatest height, metres. The default leaves room to lift an object by half a metre.
        share: least part of a mask's measured pixels between the heights, 0 to 1.

    Raises:
        PwmGymError: heights in the wrong order, or a share that is none.
    """

    def __init__(self, segmenter: Segmenter, low: float = 0.005, high: float = 0.5, share: float = 0.5) -> None:
        if not low < high:
            raise PwmGymError(f"low={low} and high={high}; expected low < high, metres")
        if not 0 <= share <= 1:
            raise PwmGymError(f"share={share}; expected 0 to 1")
        self.segmenter, self.low, self.high, self.share = segmenter, low, high, share

    def __call__(self, frame: Frame) -> dict[str, np.ndarray]:
        """The segmenter's masks, without what lies outside the heights."""
        measured = frame.valid
        height = frame.camera.back_project(np.where(measured, frame.depth, 0.0))[..., 2]  # (H, W)
        inside = measured & (height >= self.low) & (height <= self.high)
        found = self.segmenter(frame)
        kept = {name: mask & inside for name, mask in found.items()}
        least = {name: max(1.0, self.share * (mask & measured).sum()) for name, mask in found.items()}
        return {name: mask for name, mask in kept.items() if mask.sum() >= least[name]}
