"""Demonstrations of Gymnasium-Robotics' Adroit environments in Minari's format become data sets of our tasks."""

from __future__ import annotations

import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from pwm_gym.cli import main
from pwm_gym.data import KINDS, load_demonstrations, load_split
from pwm_gym.data.dataset import SPLITS, read_header
from pwm_gym.data.minari_format import import_minari
from pwm_gym.errors import DatasetError
from pwm_gym.policies.cloning import CloningConfig, clone
from pwm_gym.seeds import split_of
from pwm_gym.sim.mujoco.worlds import make_environment
from pwm_gym.tasks import get_task

minari = pytest.importorskip("minari")
from minari.data_collector import EpisodeBuffer  # noqa: E402

ENVIRONMENTS = {"AdroitHandDoor-v1": "AdroitHandDoor", "AdroitHandRelocate-v1": "AdroitHandRelocate"}
OBJECT = {"AdroitHandDoor-v1": "frame", "AdroitHandRelocate-v1": "ball"}
PLACES = {"AdroitHandDoor-v1": ("door_body_pos",), "AdroitHandRelocate-v1": ("obj_pos", "target_pos")}
ID = "D4RL/test/human-v2"
STEPS, EPISODES = 6, 4


@pytest.fixture(autouse=True)
def minari_folder(tmp_path, monkeypatch) -> Path:
    """Where Minari stores its data sets."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    (tmp_path / "minari").mkdir()
    return tmp_path / "minari"


def store(env_id, buffers, observations=(39,), actions=(28,)) -> None:
    """Write episodes as a data set that names an environment, or none."""
    make_environment("AdroitHandDoor-v1").close()  # registers them all, quietly
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of an author that Minari would like to have
        made = minari.create_dataset_from_buffers(
            ID,
            buffers,
            observation_space=gym.spaces.Box(-np.inf, np.inf, observations),
            action_space=gym.spaces.Box(-1.0, 1.0, actions, np.float32),
        )
    if env_id:
        made.storage.update_metadata({"env_spec": gym.spec(env_id).to_json()})


def buffer(number, observations, actions, infos=None, options=None):
    """An episode as Minari's collector forms it."""
    steps = len(actions)
    truncations = [False] * (steps - 1) + [True]
    return EpisodeBuffer(
        id=number,
        options=options,
        observations=observations,
        actions=actions,
        rewards=[0.0] * steps,
        terminations=[False] * steps,
        truncations=truncations,
        infos=infos,
    )


def moving_state(env_id, env, rng):
    """A state in motion, with the arm's slide off its reference, as demonstrations of humans begin."""
    state = env.get_env_state()
    qpos, qvel = state["qpos"], np.zeros_like(state["qvel"])
    qpos[:24] += rng.uniform(0.0, 0.05, 24)
    qvel[:24] = rng.normal(0.0, 1.0, 24)
    return {"qpos": qpos, "qvel": qvel, **{name: state[name] for name in PLACES[env_id]}}


def record(env_id, start="seed", infos=False, resets=True):
    """Record the raw environment under random actions, and return the first states.

    Args:
        env_id: Gymnasium id.
        start: "seed", or "options" for the way in which Farama's scripts set a first state, in motion.
        infos: whether states go into infos.
        resets: whether Minari keeps the options of a reset.
    """
    rng, env = np.random.default_rng(0), make_environment(env_id)
    states, buffers = [], []
    for k in range(EPISODES):
        observation, _ = env.reset(seed=k)
        options = None
        if start == "options":
            options = {"initial_state_dict": moving_state(env_id, env, rng)}
            observation, _ = env.reset(seed=k, options=options)
        every, observations = [env.get_env_state()], [observation]
        actions = rng.uniform(-1.2, 1.2, (STEPS, *env.action_space.shape)).astype(np.float32)
        for action in actions:
            observations.append(env.step(action)[0])
            every.append(env.get_env_state())
        told = {name: np.array([state[name] for state in every]) for name in every[0]} if infos else None
        buffers.append(buffer(k, np.array(observations), actions, told, options if resets else None))
        states.append(every[0])
    store(env_id, buffers, actions=env.action_space.shape)
    env.close()
    return states


@pytest.fixture(params=ENVIRONMENTS)
def env_id(request) -> str:
    """Each environment."""
    return request.param


def imported(folder) -> list:
    """All episodes of a data set."""
    return [episode for split in SPLITS for episode in load_split(folder, split).episodes]


def same_start(env_id, states, episodes, velocities=True) -> None:
    """Every recorded start is that of one episode."""
    row = get_task(ENVIRONMENTS[env_id]).layout.index(OBJECT[env_id])
    for state in states:
        place = state[PLACES[env_id][0]]
        episode = min(episodes, key=lambda e: np.linalg.norm(e.poses[0, row, :3] - place))
        hand = len(episode.joints[0, 0])
        np.testing.assert_allclose(episode.poses[0, row, :3], place, atol=1e-6)
        np.testing.assert_allclose(episode.joints[0, 0], state["qpos"][:hand], atol=1e-6)
        if velocities:
            np.testing.assert_allclose(episode.joints[0, 1], 0.01 * state["qvel"][:hand], atol=1e-6)
        if "target_pos" in state:
            np.testing.assert_allclose(episode.goal, state["target_pos"], atol=1e-6)


@pytest.mark.parametrize(("start", "infos"), [("seed", False), ("seed", True), ("options", False), ("options", True)])
def test_episodes_start_where_they_were_recorded_and_are_replayed(env_id, start, infos, tmp_path):
    states = record(env_id, start, infos)
    folder = import_minari(ID, tmp_path / "data", ENVIRONMENTS[env_id], tolerance=1e-6)
    episodes = imported(folder)
    assert [len(load_split(folder, split).episodes) for split in SPLITS] == [2, 1, 1]
    assert {len(episode) for episode in episodes} == {STEPS}
    same_start(env_id, states, episodes)
    recorded = {np.clip(data.actions, -1.0, 1.0).tobytes() for data in minari.load_dataset(ID)}
    assert {episode.actions.tobytes() for episode in episodes} == recorded
    replay = {"recorded": EPISODES, "left_out": 0, "tolerance": 1e-6, "split_seed": 0, "follow": False}
    settings = {"task": ENVIRONMENTS[env_id], "imported": ID, "replay": replay}
    assert read_header(folder).settings == settings


def test_episodes_are_what_the_tasks_own_simulator_makes_of_them(env_id, tmp_path):
    record(env_id)
    task = get_task(ENVIRONMENTS[env_id])
    dataset = load_split(import_minari(ID, tmp_path / "data"), "test", task.name)
    assert dataset.layout == task.layout
    episode = dataset.episodes[0]
    assert KINDS[episode.kind] == "expert" and split_of(episode.seed) == "test"
    simulator = task.make_simulator()
    simulator.restore(dataset.scene(episode))
    for action, poses, reward, success in zip(
        episode.actions, episode.poses[1:], episode.rewards, episode.success, strict=True
    ):
        outcome = simulator.step(action)
        np.testing.assert_allclose(simulator.poses(), poses, atol=1e-4)
        assert outcome.reward == pytest.approx(reward, abs=1e-3) and outcome.success == success
    simulator.close()


def test_episodes_that_began_in_motion_which_is_not_told_are_left_out(env_id, tmp_path):
    states = record(env_id, "options", resets=False)
    told = refused(tmp_path / "none", tolerance=1e-3)
    expected = "0 of 4 episodes replay within 0.001 m and rad of what was recorded; expected 3 or more"
    assert expected in told and not (tmp_path / "none").exists()
    folder = import_minari(ID, tmp_path / "all", tolerance=1.0)
    assert read_header(folder).settings["replay"]["left_out"] == 0
    same_start(env_id, states, imported(folder), velocities=False)


def test_an_episode_that_strays_is_left_out_and_counted(minari_folder, tmp_path, capsys):
    import h5py

    record("AdroitHandDoor-v1")
    with h5py.File(minari_folder / ID / "data" / "main_data.hdf5", "a") as file:
        file["episode_2/observations"][4, 3] += 0.06  # radians of a joint, at the fourth step
    main(["data", "import", ID, "--out", str(tmp_path / "data")])
    told = capsys.readouterr().out
    assert f"data set: {tmp_path / 'data'}" in told and "3 of 4 episodes, 0 with success; left out" in told
    assert "strays by more than 0.05 m or rad: 1" in told
    assert read_header(tmp_path / "data").settings["replay"]["left_out"] == 1
    main(["data", "import", ID, "--out", str(tmp_path / "more"), "--tolerance", "0.07"])
    assert "4 of 4 episodes, 0 with success" in capsys.readouterr().out


def test_replayed_demonstrations_succeed_as_recorded_ones_did(tmp_path, capsys):
    task, env = get_task("AdroitHandDoor"), make_environment("AdroitHandDoor-v1")
    simulator, buffers = task.make_simulator(), []
    for k in range(3):
        simulator.reset(k)
        expert, done = task.expert(np.random.default_rng(k)), False
        observations, actions = [env.reset(seed=k)[0]], []
        while not done:
            actions.append(expert.act(simulator.poses(), simulator.goal()))
            done = simulator.step(actions[-1]).success
            observations.append(env.step(actions[-1])[0])
        buffers.append(buffer(k, np.array(observations), np.array(actions, np.float32)))
    simulator.close()
    env.close()
    store("AdroitHandDoor-v1", buffers)
    main(["data", "import", ID, "--out", str(tmp_path / "data")])
    assert "3 of 3 episodes, 3 with success" in capsys.readouterr().out
    episodes = imported(tmp_path / "data")
    assert all(episode.success[-1] and episode.success.sum() == 1 for episode in episodes)
    assert len({episode.seed for episode in episodes}) == 3


def test_followed_episodes_keep_to_the_recorded_positions(env_id, tmp_path):
    record(env_id, "options", resets=False)  # in motion, which replays do not know
    folder, data = import_minari(ID, tmp_path / "data", tolerance=1.0, follow=True), minari.load_dataset(ID)
    loose = imported(import_minari(ID, tmp_path / "loose", tolerance=1.0))
    hand = slice(0, 27) if "Door" in env_id else slice(0, 30)
    for episodes, near in ((imported(folder), True), (loose, False)):
        for episode in episodes:
            row = min(data, key=lambda d: np.abs(d.actions.clip(-1, 1) - episode.actions).max())
            joints = episode.joints[:, 0, 1:] if "Door" in env_id else episode.joints[:, 0]
            assert np.allclose(joints, row.observations[:, hand], atol=1e-6) == near


def test_the_draw_of_the_splits_is_seeded(tmp_path):
    record("AdroitHandRelocate-v1")
    tests = [
        load_split(import_minari(ID, tmp_path / f"{k}", split_seed=seed), "test").episodes[0].actions.tobytes()
        for k, seed in enumerate([0, 0, 1, 2, 3, 4])
    ]
    assert tests[0] == tests[1] and len({*tests}) > 1


def test_policies_are_cloned_from_them(env_id, tmp_path):
    record(env_id)
    folder, task = import_minari(ID, tmp_path / "data"), ENVIRONMENTS[env_id]
    assert len(load_demonstrations(folder, "train", task).episodes) == 2
    config = CloningConfig(phases=((1, 4, 8),), validate_every=4, threads=1)
    clone(task, folder, tmp_path / "policy", config, progress=False)
    assert (tmp_path / "policy").is_dir()


# What is refused --------------------------------------------------------------------------------------------------


def refused(folder, task=None, **options) -> str:
    """What an import says."""
    with pytest.raises(DatasetError) as error:
        import_minari(ID, folder, task, **options)
    return str(error.value)


def write(env_id, observations=(39,), actions=(28,), steps=STEPS, infos=None, rows=1):
    """A data set of one episode of zeros."""
    values = np.zeros((steps + rows, *observations)), np.zeros((steps, *actions), np.float32)
    store(env_id, [buffer(0, *values, infos)], observations, actions)


def test_another_task_is_refused(env_id, tmp_path):
    write(env_id)
    told = refused(tmp_path / "data", "PickCube")
    assert told == f"'{ID}' is a data set of task '{ENVIRONMENTS[env_id]}'; expected 'PickCube'"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"actions": (30,)}, "has actions of shape (30,); task 'AdroitHandDoor' expects (28,)"),
        ({"observations": (45,)}, "expected a Box of shape (39,)"),
        ({"rows": 0}, "episode 0: observations have shape (6, 39); expected (7, 39)"),
        ({"steps": 2}, "episode 0: it has 2 steps; expected 3 or more"),
        ({"infos": {"qpos": np.zeros((7, 30))}}, "its first state has qpos and no qvel; expected qpos and qvel"),
        ({"infos": {"qpos": np.zeros((7, 9)), "qvel": np.zeros((7, 30))}}, "has shape (9,); expected (30,)"),
        ({"infos": {"qpos": np.full((7, 30), np.nan), "qvel": np.zeros((7, 30))}}, "qpos holds 30 values"),
    ],
)
def test_data_of_another_form_are_refused(changes, told, tmp_path):
    write("AdroitHandDoor-v1", **changes)
    assert told in refused(tmp_path / "data") and not (tmp_path / "data").exists()


def test_a_tolerance_that_cannot_be_is_refused(tmp_path):
    write("AdroitHandDoor-v1")
    assert refused(tmp_path / "data", tolerance=0.0) == "tolerance=0.0; expected more than 0"


@pytest.mark.parametrize(("other", "named"), [("AdroitHandPen-v1", "AdroitHandPen-v1"), ("", "no environment")])
def test_an_environment_that_is_no_known_task_is_named(other, named, tmp_path):
    write(other)
    told = refused(tmp_path / "data")
    assert f"is of {named}; expected" in told and "AdroitHandDoor-v1 or AdroitHandRelocate-v1" in told
