import pytest

from pwm_gym.costs import COSTS, GRASPS, SUCCESSES
from pwm_gym.errors import UnknownNameError
from pwm_gym.tasks import TASKS, get_task, register_task


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_a_tasks_parts_fit_together(task):
    assert len(task.robot.action_names) == task.action_size
    assert task.objects[0] in task.layout.names and not task.layout[task.objects[0]].effector
    assert {task.cost, task.plan_cost} <= set(COSTS)
    assert task.success in SUCCESSES and task.grasp in GRASPS
    assert all(b - a == 3 and b <= task.action_size for a, b in task.control.vectors)
    roots = [e.name for e in task.layout if e.driven and not e.joint.moves]
    assert all(e.slider.parent in roots for e in task.layout if e.slider)
    assert task.description and task.max_episode_steps > 0


def test_the_papers_point_count():
    assert get_task("PickCube").layout.points == 1200


def test_an_unknown_task_is_answered_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"unknown task 'PickCub'; known: .*Did you mean 'PickCube'\?"):
        get_task("PickCub")


def test_a_name_is_taken_once():
    with pytest.raises(ValueError, match="'PickCube' is registered already"):
        register_task(get_task("PickCube"))
