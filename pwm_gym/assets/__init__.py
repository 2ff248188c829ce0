"""Objects for ManiSkill's PickSingleYCB: built from meshes, or generated; their grasps and an expert that uses them."""

from pwm_gym.assets.build import build_ycb
from pwm_gym.assets.folder import AssetFolder
from pwm_gym.assets.generated import GENERATED_OBJECTS, generated_assets, generated_pieces
from pwm_gym.assets.grasps import Grasp, ObjectGrasps, find_grasps
from pwm_gym.assets.known import object_grasps
from pwm_gym.assets.names import UNSEEN_PREFIXES, YCB_OBJECTS, is_unseen, splits
from pwm_gym.assets.root import MissingAssetsError, asset_root, require_ycb, use_assets

__all__ = [
    "GENERATED_OBJECTS",
    "UNSEEN_PREFIXES",
    "YCB_OBJECTS",
    "AssetFolder",
    "Grasp",
    "MissingAssetsError",
    "ObjectGrasps",
    "asset_root",
    "build_ycb",
    "find_grasps",
    "generated_assets",
    "generated_pieces",
    "is_unseen",
    "object_grasps",
    "require_ycb",
    "splits",
    "use_assets",
]
