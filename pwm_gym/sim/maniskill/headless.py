"""SAPIEN on a machine without a Vulkan device.

ManiSkill tasks build render materials even with ``render_backend="none"``, and SAPIEN raises where it finds no
device. There, and only there, the two classes are replaced by inert objects; physics does not read them.
"""

from __future__ import annotations

import sys
from typing import Any

__all__ = ["allow_headless"]

_NAMES = ("RenderMaterial", "RenderTexture2D")


class _Inert:
    """Takes any argument, attribute and call, and does nothing."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *args, **kwargs: None


def allow_headless() -> bool:
    """Make ManiSkill importable and runnable here; returns whether a real renderer is missing."""
    import sapien.render

    if sapien.render.RenderMaterial is _Inert:
        return True
    try:
        sapien.render.RenderMaterial()
    except RuntimeError:
        _replace()
        return True
    return False


def _replace() -> None:
    """Put the inert class wherever a loaded module holds one of the originals."""
    import sapien.pysapien.render as native

    originals = {getattr(native, name) for name in _NAMES}
    for module in [m for n, m in sys.modules.items() if n.split(".")[0] in ("sapien", "mani_skill")]:
        for name in _NAMES:
            if getattr(module, name, None) in originals:
                setattr(module, name, _Inert)
