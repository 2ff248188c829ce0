"""Metrics, tables and floors. They receive models, data sets, environments or simulators as arguments."""

from pwm_gym.evaluation.metrics import chamfer, pearson
from pwm_gym.evaluation.planning import (
    episodes_in,
    plan_episodes,
    planning_table,
    run_episodes,
    run_seeds,
    save_runs,
    wilson,
)
from pwm_gym.evaluation.ranking import max_rank_violation, ranking_table
from pwm_gym.evaluation.record import write_results
from pwm_gym.evaluation.report import evaluate_rollouts
from pwm_gym.evaluation.rollouts import long_rollouts, predict, validation_metrics

__all__ = [
    "chamfer",
    "episodes_in",
    "evaluate_rollouts",
    "long_rollouts",
    "max_rank_violation",
    "pearson",
    "plan_episodes",
    "planning_table",
    "predict",
    "ranking_table",
    "run_episodes",
    "run_seeds",
    "save_runs",
    "validation_metrics",
    "wilson",
    "write_results",
]
