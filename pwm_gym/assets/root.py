"""Which folder of objects ManiSkill's PickSingleYCB reads.

ManiSkill fixes its asset folder when it is first imported, in a constant that its modules copy, and asks on the
terminal whether to download what is missing. :func:`use_assets` sets the constants of the modules that read YCB
objects, whenever ManiSkill was imported, and leaves its other assets where they are.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from pwm_gym.assets.folder import AssetFolder
from pwm_gym.errors import PwmGymError

__all__ = ["MissingAssetsError", "asset_root", "require_ycb", "use_assets"]


class MissingAssetsError(PwmGymError):
    """Objects that a task needs have not been built or downloaded."""


def asset_root() -> Path:
    """Folder in which ManiSkill looks for assets: ``MS_ASSET_DIR``, or ``~/.maniskill``."""
    return Path(os.environ.get("MS_ASSET_DIR") or "~/.maniskill").expanduser()


def require_ycb(root: str | Path | None = None, objects: tuple[str, ...] = ()) -> AssetFolder:
    """Folder of YCB objects, found without asking anything.

    Args:
        root: as ``MS_ASSET_DIR`` names it; None for :func:`asset_root`.
        objects: names that must be there.

    Raises:
        MissingAssetsError: the folder, or one of the objects, is not there.
    """
    folder = AssetFolder(asset_root() if root is None else Path(root).expanduser())
    if not folder.exists():
        raise MissingAssetsError(f"no YCB objects in {folder.base}; {_ways(folder.root)}")
    listed = folder.info()
    for name in objects:
        if name not in listed or not folder.has(name):
            raise MissingAssetsError(f"{folder.base} has no object {name!r}; {_ways(folder.root)}")
    return folder


def use_assets(folder: AssetFolder) -> None:
    """Let ManiSkill's YCB tasks of this process read ``folder``, from their next scene on."""
    from pwm_gym.sim.maniskill.headless import allow_headless

    allow_headless()
    # by name: as an attribute, mani_skill.utils is another module
    task: Any = import_module("mani_skill.envs.tasks.tabletop.pick_single_ycb")
    builder: Any = import_module("mani_skill.utils.building.actors.ycb")
    sources = import_module("mani_skill.utils.assets.data").DATA_SOURCES
    allow_headless()  # once more, for the modules that these imports have loaded
    data = folder.root.resolve() / "data"
    task.ASSET_DIR = data
    builder.ASSET_DIR = data
    builder.YCB_DATASET.clear()  # the list of another folder
    sources["ycb"].output_dir = data


def _ways(root: Path) -> str:
    """How the objects get there."""
    return (
        f'build them from meshes with "pwm-gym assets ycb --from MESHES --out {root}", or download ManiSkill\'s with '
        f'"MS_ASSET_DIR={root} python -m mani_skill.utils.download_asset ycb"'
    )
