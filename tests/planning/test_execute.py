from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation import planning_table, run_episodes
from pwm_gym.planning import Run, execute
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task


class Counter(gym.Env):
    """Succeeds after as many steps as its seed says; the scene's last action tells the number of steps made."""

    def __init__(self, scene):
        self._scene = scene

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._goal, self._step = seed, 0
        return 0, {"success": seed == 0}

    def step(self, action):
        self._step += 1
        success = self._step >= self._goal
        return self._step, 0.5, success, False, {"success": success}

    def scene(self, truth=False):
        return replace(self._scene, last_action=np.full(7, self._step, np.float32))


class Recorder:
    """An agent that writes down what it is asked; its actions are the scenes' numbers of steps."""

    device = "cpu"

    def __init__(self):
        self.seeds, self.scenes, self.advanced = [], [], []

    def reset(self, seed):
        self.seeds.append(seed)

    def act(self, scene):
        self.scenes.append(None if scene is None else int(scene.last_action[0]))
        if scene is not None:
            self.state = batch_state([scene])
        return np.full(7, len(self.scenes) - 1, np.float32)

    def advance(self, action):
        self.advanced.append(int(action[0]))
        return self.state

    def terms(self, states, actions):
        return {"steps": np.arange(len(actions), dtype=np.float32)}

    def rewards(self, states, actions, *judged_by):
        return np.zeros(len(actions))

    def describe(self):
        return {"planner": "Recorder"}


@pytest.fixture
def counter(scene):
    return Counter(scene)


def test_closed_loop_plans_from_the_scene_after_every_action(counter):
    agent = Recorder()
    run = execute(counter, agent, seed=3)
    assert agent.seeds == [3] and agent.scenes == agent.advanced == [0, 1, 2]
    assert run.success and run.steps == 3 and not run.at_reset and run.chunk == 1
    assert run.actions[:, 0].tolist() == [0, 1, 2]
    assert run.rewards.tolist() == [0.5] * 3 and run.plan_seconds.shape == (3,)
    assert run.poses.shape == (4, 4, 7) and run.predicted.shape == (3, 4, 7)
    assert run.terms["steps"].tolist() == [0, 1, 2] and run.settings == {"planner": "Recorder"}


@pytest.mark.parametrize(("chunk", "looks"), [(2, [0, None, 2, None, 4]), (3, [0, None, None, 3, None])])
def test_chunks_look_every_so_many_steps(counter, chunk, looks):
    agent = Recorder()
    execute(counter, agent, seed=5, chunk=chunk)
    assert agent.scenes == looks and agent.advanced == [0, 1, 2, 3, 4]


def test_open_loop_looks_once(counter):
    agent = Recorder()
    execute(counter, agent, seed=4, chunk=0)
    assert agent.scenes == [0, None, None, None]


def test_a_negative_chunk_is_a_clear_error(counter):
    with pytest.raises(PwmGymError, match="chunk=-1; expected 0"):
        execute(counter, Recorder(), seed=4, chunk=-1)


def test_no_steps_are_a_clear_error(counter):
    with pytest.raises(PwmGymError, match="max_steps=0; expected at least 1"):
        execute(counter, Recorder(), seed=4, max_steps=0)


def test_an_agent_may_see_less_than_the_scene(counter):
    agent = Recorder()
    execute(counter, agent, 2, observe=lambda scene: replace(scene, last_action=10 + scene.last_action))
    assert agent.scenes == [10, 11]


class Passing(Counter):
    """A success at one step alone, as something that slides through its goal."""

    def step(self, action):
        number, reward, _, truncated, _ = super().step(action)
        success = self._step == self._goal
        return number, reward, success, truncated, {"success": success}


@pytest.mark.parametrize(("world", "lasts"), [(Counter, True), (Passing, False)])
def test_to_the_end_tells_whether_success_lasts(scene, tmp_path, world, lasts):
    run = execute(world(scene), Recorder(), seed=3, max_steps=6, to_the_end=True)
    assert run.steps == 6 and run.success and run.steps_to_success == 3 and run.holds is lasts
    assert run.solved.tolist() == [False, False, True, *[lasts] * 3]
    run.save(tmp_path / "run.npz")
    loaded = Run.load(tmp_path / "run.npz")
    assert np.array_equal(loaded.solved, run.solved)
    table = planning_table([run])
    assert table["successes"] == 1 and table["mean_steps_of_successes"] == 3.0 and table["runs"][0]["steps"] == 3


def test_a_record_of_an_earlier_version_ends_with_its_success(counter):
    run = replace(execute(counter, Recorder(), seed=3), solved=None)
    assert run.holds and run.steps_to_success == 3
    failed = replace(execute(counter, Recorder(), seed=50, max_steps=4), solved=None)
    assert not failed.holds and failed.steps_to_success is None


def test_it_stops_at_the_step_limit(counter):
    run = execute(counter, Recorder(), seed=50, max_steps=7)
    assert run.steps == 7 and not run.success


def test_episodes_that_succeed_at_reset_are_left_out(counter):
    runs = run_episodes(counter, Recorder(), [0, 2, 50, 4], max_steps=10, progress=False)
    assert [(r.seed, r.success) for r in runs] == [(2, True), (50, False), (4, True)]
    table = planning_table(runs)
    assert (table["episodes"], table["successes"], table["failed_seeds"]) == (3, 2, [50])
    assert table["mean_steps_of_successes"] == 3.0


def test_a_killed_run_goes_on_where_it_was_and_a_folder_belongs_to_one_recipe(counter, tmp_path):
    def plan(seeds, recipe):
        agent = Recorder()
        runs = run_episodes(counter, agent, seeds, 10, progress=False, folder=tmp_path, recipe=recipe)
        return [(r.seed, r.success, r.steps) for r in runs], len(agent.scenes)

    first, looks = plan([0, 2], {"chunk": 1})
    assert looks > 0 and first == [(2, True, 2)]
    again, looks = plan([0, 2], {"chunk": 1})
    assert looks == 0 and again == first  # the one that succeeds at reset is not planned again, either
    more, looks = plan([0, 2, 4], {"chunk": 1})
    assert looks == 4 and more == [*first, (4, True, 4)]
    (tmp_path / "seed-2.npz").write_bytes(b"half a rec")
    assert plan([0, 2, 4], {"chunk": 1}) == (more, 2)
    with pytest.raises(PwmGymError, match=r"planned with {'chunk': 1}; expected {'chunk': 0}, or another folder"):
        plan([2], {"chunk": 0})
    (tmp_path / "planned-by.json").write_text("{")
    with pytest.raises(PwmGymError, match="planned-by.json is truncated or not valid"):
        plan([2], {"chunk": 1})
    (tmp_path / "planned-by.json").unlink()
    with pytest.raises(PwmGymError, match="holds runs and no planned-by.json; expected another folder"):
        plan([2], {"chunk": 1})


def test_successes_are_told_by_object_where_episodes_have_different_ones(counter):
    run = execute(counter, Recorder(), seed=9, max_steps=2)
    count = len(run.start.layout)
    names = [("link",) * (count - 1) + (name,) for name in ("can", "bar", "can")]
    driven = {e.name for e in run.start.layout if e.driven}
    assert len(driven) == count - 1
    runs = [replace(run, start=replace(run.start, assets=assets), success=k == 2) for k, assets in enumerate(names)]
    assert planning_table(runs)["objects"] == {
        "bar": {"episodes": 1, "successes": 0},
        "can": {"episodes": 2, "successes": 1},
    }
    assert planning_table([run])["objects"] == {}


def test_a_table_of_failures_has_no_steps_to_success(counter):
    run = replace(execute(counter, Recorder(), seed=9, max_steps=2), plan_seconds=np.array([0.1, 0.3]))
    table = planning_table([run])
    assert table["successes"] == 0 and table["mean_steps_of_successes"] is None
    assert table["plan_seconds"]["median"] == pytest.approx(0.2)
    assert table["interval"][0] == 0


def test_a_perfect_agent_succeeds_in_the_twin(sim):
    class Expert(Recorder):
        def reset(self, seed):
            self.expert = get_task("PickCube").expert(np.random.default_rng(seed))

        def act(self, scene):
            super().act(scene)
            return self.expert.act(scene.poses[0], scene.goal)

    env = gym.wrappers.TimeLimit(sim.unwrapped, 130)
    run = execute(env, Expert(), seed=300_000, max_steps=130)
    assert run.success and 20 < run.steps < 120
    assert run.rewards[-1] > run.rewards[0]
