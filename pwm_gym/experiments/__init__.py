"""The tables of the documentation: what to train and to plan for each row, in resumable pieces."""

from pwm_gym.experiments.members import run_planning_table
from pwm_gym.experiments.tables import TABLES, run_table

__all__ = ["TABLES", "run_planning_table", "run_table"]
