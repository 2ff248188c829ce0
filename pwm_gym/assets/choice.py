"""Which objects may occur in PickSingleYCB, and how ManiSkill is made to take one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.generated import generated_assets
from pwm_gym.assets.liftable import liftable_objects
from pwm_gym.assets.names import GENERATED_PREFIX, is_unseen
from pwm_gym.assets.root import asset_root, require_ycb, use_assets
from pwm_gym.errors import PwmGymError, unknown_name

__all__ = ["OBJECT_SETS", "ObjectChoice", "available_assets", "select_objects"]

OBJECT_SETS = ("seen", "unseen", "liftable", "unseen_liftable", "all")
"""Names of sets of objects: of training; held out; of training and lifted by the expert; held out and lifted; any."""


def available_assets() -> AssetFolder:
    """The user's YCB objects where they are (see :func:`~pwm_gym.assets.asset_root`), else the generated shapes."""
    folder = AssetFolder(asset_root())
    return folder if folder.exists() else generated_assets()


def select_objects(folder: AssetFolder, objects: str | Sequence[str]) -> tuple[str, ...]:
    """Names of the objects in ``folder`` that ``objects`` stands for, in alphabetical order.

    Args:
        folder: of the objects.
        objects: one of :data:`OBJECT_SETS`, an object's name, or names.

    Raises:
        UnknownNameError: neither a set nor an object.
        MissingAssetsError: a named object is not in the folder.
        PwmGymError: the folder has none of the set.
    """
    names = folder.names()
    if isinstance(objects, str) and objects not in OBJECT_SETS:
        if objects not in names:
            raise unknown_name("object or set of objects", objects, [*OBJECT_SETS, *names])
        return (objects,)
    if not isinstance(objects, str):
        require_ycb(folder.root, tuple(objects))
        return tuple(sorted(objects))
    found = tuple(name for name in names if _belongs(name, objects))
    if not found:
        raise PwmGymError(f"none of the {len(names)} objects in {folder.base} is {objects.replace('_', ' and ')}")
    return found


def _belongs(name: str, group: str) -> bool:
    if group == "all":
        return True
    split_fits = is_unseen(name) == group.startswith("unseen")
    return split_fits and (_is_liftable(name) or not group.endswith("liftable"))


def _is_liftable(name: str) -> bool:
    """Whether the scripted expert lifts it; it does all the generated shapes."""
    return name.startswith(GENERATED_PREFIX) or name in liftable_objects()


@dataclass(frozen=True)
class ObjectChoice:
    """The object of PickSingleYCB's scenes; a :class:`pwm_gym.sim.maniskill.AssetChoice`."""

    folder: AssetFolder
    objects: tuple[str, ...]
    """Those that a seed draws from; a scene may name any of the folder's."""
    entity: str = "object"
    """What the task calls the object."""

    def force(self, env: Any, assets: Mapping[str, str] | None) -> None:
        """Make the next scene of these assets, or of one that the seed draws.

        Raises:
            MissingAssetsError: the folder has no such object.
        """
        objects = self.objects if assets is None else (assets[self.entity],)
        require_ycb(self.folder.root, objects)
        use_assets(self.folder)  # another simulator of this process may have another folder
        env.all_model_ids = np.array(objects)

    def names(self, env: Any) -> Mapping[str, str]:
        """The object's name."""
        return {self.entity: self.actor(env).name.rsplit("-", 1)[0]}  # ManiSkill appends the environment's number

    @staticmethod
    def actor(env: Any) -> Any:
        """The object's actor."""
        return env._objs[0]
