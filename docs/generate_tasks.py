"""Write docs/tasks.md from the registry of tasks: python docs/generate_tasks.py."""

from __future__ import annotations

from pathlib import Path

from task_parts import entities, facts, planning_cost, reward

from pwm_gym.tasks import TASKS, Task

DOCS = Path(__file__).parent
PAGE = DOCS / "tasks.md"
_INTRO = """# Tasks

Written by `python docs/generate_tasks.py`. Spaces, rewards and infos that all tasks share:
[environments.md](environments.md); figures: [results.md](results.md); a task of your own: [own_task.md](own_task.md).
"""
_MORE = {
    "PickYCB": "Where its objects come from, and which are kept out of training: [ycb.md](ycb.md).\n",
    "MugCleanup": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `MugCleanup-v1` there.\n",
    "Coffee": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `Coffee-v1` there.\n",
    "CoffeePreparation": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `CoffeePreparation-v1` "
    "there. No model is trained on it: it is made of parts of MugCleanup and Coffee.\n",
    "TwoArmBoxCleanup": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers `TwoArmBoxCleanup-v1` "
    "there, with the robot `two_hands`, in one environment on the CPU. The hands are boxes of our own geometry; their "
    "second finger joints follow the first by a rule that the controller keeps. An arm whose tool would be more than "
    '2 mm off its target holds; `info["holding"]` names it.\n',
    "TwoArmDrawerCleanup": "In ManiSkill, too: `import pwm_gym.sim.maniskill.scenes` registers "
    "`TwoArmDrawerCleanup-v1` there. The robot is TwoArmBoxCleanup's.\n",
    "AdroitHandDoor": "Its script, whose numbers were found by the cross-entropy method, "
    "opens the door in most episodes. The reward is Gymnasium-Robotics' own, whose first term pays for "
    "distance from the handle; planners get a cost of their own.\n",
    "OGBenchCubeSingle": "OGBench's `cube-single` (extra `ogbench`), whose own evaluation tasks are starts: "
    "[mujoco.md](mujoco.md#ogbench).\n",
    "OGBenchCubeDouble": "OGBench's `cube-double` (extra `ogbench`), whose own evaluation tasks are starts: "
    "[mujoco.md](mujoco.md#ogbench).\n",
    "AdroitHandRelocate": "Its script, whose numbers were found by the cross-entropy "
    "method, brings the ball to its goal. The reward is Gymnasium-Robotics' own, whose first "
    "term pays for distance from the ball; planners get a cost of their own.\n",
}


def page() -> str:
    """The page's text."""
    return "\n".join([_INTRO, *(_section(task) for task in TASKS.values())])


def _section(task: Task) -> str:
    lines = [f"## {task.name}", "", task.description, ""]
    if (DOCS / "images" / f"{task.name}.png").exists():
        lines += [f"![A rollout: predicted (teal) over true (purple)](images/{task.name}.png)", ""]
    lines += [*facts(task), "", *entities(task)]
    lines += ["", reward(task), "", *planning_cost(task)]
    return "\n".join([*lines, "", _MORE.get(task.name, "")])


if __name__ == "__main__":
    PAGE.write_text(page())
