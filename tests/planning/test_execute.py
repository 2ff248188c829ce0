import gymnasium as gym
import numpy as np
import pytest

from pwm_gym.evaluation import planning_table, run_episodes
from pwm_gym.planning import Run, closed_loop
from pwm_gym.tasks import get_task


class Counter(gym.Env):
    """Succeeds after as many steps as its seed says; a scene is the number of steps made."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._goal, self._step = seed, 0
        return 0, {"success": seed == 0}

    def step(self, action):
        self._step += 1
        success = self._step >= self._goal
        return self._step, 0.5, success, False, {"success": success}

    def scene(self):
        return self._step


class Recorder:
    """An agent that writes down what it is asked."""

    def __init__(self):
        self.seeds, self.scenes = [], []

    def reset(self, seed):
        self.seeds.append(seed)

    def act(self, scene):
        self.scenes.append(scene)
        return np.full(7, scene, np.float32)


def test_it_plans_from_the_scene_after_every_action():
    agent, shown = Recorder(), []
    run = closed_loop(Counter(), agent, seed=3, on_scene=shown.append)
    assert agent.seeds == [3] and agent.scenes == [0, 1, 2]
    assert shown == [0, 1, 2, 3]
    assert run.success and run.steps == 3 and not run.at_reset
    assert [a[0] for a in run.actions] == [0, 1, 2]
    assert run.rewards == [0.5] * 3 and len(run.plan_seconds) == len(run.infos) == 3


def test_it_stops_at_the_step_limit():
    run = closed_loop(Counter(), Recorder(), seed=50, max_steps=7)
    assert run.steps == 7 and not run.success


def test_episodes_that_succeed_at_reset_are_left_out():
    runs = run_episodes(Counter(), Recorder(), [0, 2, 50, 4], max_steps=10, progress=False)
    assert [(r.seed, r.success) for r in runs] == [(2, True), (50, False), (4, True)]
    table = planning_table(runs)
    assert (table["episodes"], table["successes"], table["failed_seeds"]) == (3, 2, [50])
    assert table["mean_steps_of_successes"] == 3.0


def test_a_table_of_failures_has_no_steps_to_success():
    run = Run(seed=7, actions=[np.zeros(7)] * 2, plan_seconds=[0.1, 0.3])
    table = planning_table([run])
    assert table["successes"] == 0 and table["mean_steps_of_successes"] is None
    assert table["plan_seconds"]["median"] == pytest.approx(0.2)
    assert table["interval"][0] == 0


def test_a_perfect_agent_succeeds_in_the_twin(sim):
    class Expert(Recorder):
        def reset(self, seed):
            self.expert = get_task("PickCube").expert(np.random.default_rng(seed))

        def act(self, scene):
            return self.expert.act(scene.poses[0], scene.goal)

    env = gym.wrappers.TimeLimit(sim.unwrapped, 130)
    run = closed_loop(env, Expert(), seed=300_000, max_steps=130)
    assert run.success and 20 < run.steps < 120
    assert run.rewards[-1] > run.rewards[0]
