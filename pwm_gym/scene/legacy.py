"""Layouts of version 0.1: a list of entities, whose links slide on the hand; the table was understood."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from pwm_gym.scene.layout import Support

__all__ = ["upgrade_layout"]


def upgrade_layout(data: Any) -> Any:
    """The present JSON form of a layout of version 0.1; anything else as it is."""
    if not isinstance(data, list) or not all(isinstance(item, dict) for item in data):
        return data
    return {"entities": [_entity(item) for item in data], "supports": [asdict(Support.ground())]}


def _entity(item: dict[str, Any]) -> dict[str, Any]:
    kept: dict[str, Any] = {key: item[key] for key in ("name", "start", "stop") if key in item}
    slider = item.get("slider")
    joint: dict[str, Any] = {"joint": {"kind": "prismatic", **slider}} if isinstance(slider, dict) else {}
    return {**kept, "driven": item.get("effector", False), **joint}
