"""Point-cloud costs, success rules and grasp rules, by name."""

from pwm_gym.costs import contacts, drawers, lids, motion, objects, sequences, shaped, terms
from pwm_gym.costs.registry import (
    COSTS,
    GRASPS,
    SUCCESSES,
    Cost,
    Points,
    cost_info,
    get_cost,
    get_grasp,
    get_success,
    register_cost,
    register_grasp,
    register_success,
    register_terms,
)
from pwm_gym.costs.stages import FINISHED, STAGES_LEFT, UNDONE, Stage, StagedCost, register_stages

__all__ = [
    "COSTS",
    "FINISHED",
    "GRASPS",
    "STAGES_LEFT",
    "SUCCESSES",
    "UNDONE",
    "Cost",
    "Points",
    "Stage",
    "StagedCost",
    "contacts",
    "cost_info",
    "drawers",
    "get_cost",
    "get_grasp",
    "get_success",
    "lids",
    "motion",
    "objects",
    "register_cost",
    "register_grasp",
    "register_stages",
    "register_success",
    "register_terms",
    "sequences",
    "shaped",
    "terms",
]
