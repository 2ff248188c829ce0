"""Objects for ManiSkill's PickSingleYCB: built from meshes, or generated; which may occur, and their grasps."""

from pwm_gym.assets.build import build_ycb
from pwm_gym.assets.choice import OBJECT_SETS, ObjectChoice, available_assets, select_objects
from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.generated import GENERATED_OBJECTS, generated_assets, generated_pieces
from pwm_gym.assets.known import object_grasps
from pwm_gym.assets.names import UNSEEN_PREFIXES, YCB_OBJECTS, is_unseen, splits
from pwm_gym.assets.root import MissingAssetsError, asset_root, require_ycb, use_assets

__all__ = [
    "GENERATED_OBJECTS",
    "OBJECT_SETS",
    "UNSEEN_PREFIXES",
    "YCB_OBJECTS",
    "AssetFolder",
    "MissingAssetsError",
    "ObjectChoice",
    "asset_root",
    "available_assets",
    "build_ycb",
    "generated_assets",
    "generated_pieces",
    "is_unseen",
    "object_grasps",
    "require_ycb",
    "select_objects",
    "splits",
    "use_assets",
]
