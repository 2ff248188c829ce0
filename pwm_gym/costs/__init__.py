"""Point-cloud costs, success rules and grasp rules, by name."""

from pwm_gym.costs import contacts, drawers, lids, motion, objects, terms
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

__all__ = [
    "COSTS",
    "GRASPS",
    "SUCCESSES",
    "Cost",
    "Points",
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
    "register_success",
    "register_terms",
    "terms",
]
