"""Objects for ManiSkill's PickSingleYCB: built from meshes, or generated."""

from pwm_gym.assets.build import build_ycb
from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.names import UNSEEN_PREFIXES, YCB_OBJECTS, is_unseen, splits

__all__ = ["UNSEEN_PREFIXES", "YCB_OBJECTS", "AssetFolder", "build_ycb", "is_unseen", "splits"]
