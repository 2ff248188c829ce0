"""One file a task: entities, cost, success rule and the scripted expert."""

from pwm_gym.tasks import pick_cube, pick_ycb, stack_cube

# isort: split
from pwm_gym.tasks import (
    coffee,
    coffee_preparation,
    mug_cleanup,
)  # after those: the order of registration is that of tables

# isort: split
from pwm_gym.tasks import fetch_pick_and_place, fetch_push, fetch_reach, fetch_slide

# isort: split
from pwm_gym.tasks import adroit_door, adroit_relocate

# isort: split
from pwm_gym.tasks import ogbench_cube

# isort: split
from pwm_gym.tasks import two_arm_box_cleanup, two_arm_drawer_cleanup
from pwm_gym.tasks.registry import TASKS, Expert, HandPosture, Task, get_task, register_task

__all__ = [
    "TASKS",
    "Expert",
    "HandPosture",
    "Task",
    "adroit_door",
    "adroit_relocate",
    "coffee",
    "coffee_preparation",
    "fetch_pick_and_place",
    "fetch_push",
    "fetch_reach",
    "fetch_slide",
    "get_task",
    "mug_cleanup",
    "ogbench_cube",
    "pick_cube",
    "pick_ycb",
    "register_task",
    "stack_cube",
    "two_arm_box_cleanup",
    "two_arm_drawer_cleanup",
]
