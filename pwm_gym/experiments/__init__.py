"""The tables of the documentation: what to train and to plan for each row, in resumable pieces."""

from pwm_gym.experiments.distractors import run_distractor_table
from pwm_gym.experiments.members import run_planning_table
from pwm_gym.experiments.shared import run_shared_table
from pwm_gym.experiments.tables import TABLES, run_table

__all__ = ["TABLES", "run_distractor_table", "run_planning_table", "run_shared_table", "run_table"]
