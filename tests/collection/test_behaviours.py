from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pwm_gym.collection import CollectConfig
from pwm_gym.collection.behaviours import Demonstration, Mirrored, OnPolicy, Practice
from pwm_gym.collection.extents import Extents
from pwm_gym.collection.shards import Shard
from pwm_gym.collection.starts import mirror, perturb
from pwm_gym.errors import SceneError
from pwm_gym.tasks import get_task

TASK, STACK, MUG = get_task("PickCube"), get_task("StackCube"), get_task("MugCleanup")


class Still:
    """A simulator in which nothing moves."""

    def __init__(self):
        self._poses = np.zeros((4, 7))
        self._poses[:, 3] = 1.0
        self._poses[:3, :3] = [[0.6, 0.0, 0.3], [0.6, 0.04, 0.24], [0.6, -0.04, 0.24]]
        self._poses[:3, 3:] = [0, 1, 0, 0]
        self._poses[3, :3] = [0.6, 0.05, 0.02]

    def poses(self):
        return self._poses.copy()

    def goal(self):
        return np.array([0.6, 0.0, 0.2], np.float32)

    def assets(self):
        return TASK.layout.names

    def joints(self):
        return np.zeros((2, 9), np.float32)

    def meshes(self):
        return {name: trimesh.creation.box([0.04] * 3) for name in TASK.layout.names}


class Counting(Still):
    """The same, counting its steps."""

    steps = 0

    def step(self, action):
        self.steps += 1


def check_starts(start, length, begun):
    """Episodes of 40 seeds start up to ``length`` steps along the expert's way, or all at its beginning."""
    counts = []
    for seed in range(40):
        still = Counting()
        start(seed, still)
        counts.append(still.steps)
    share = np.mean(np.array(counts) > 0)
    assert (0.7 < share < 0.97 and max(counts) > 200 and max(counts) < length) if begun else share == 0


def demonstrations(count, **settings):
    return [Demonstration(TASK, np.random.default_rng([seed, 0]), **settings) for seed in range(count)]


def test_about_a_fifth_of_the_demonstrations_switch_to_random_actions():
    made = demonstrations(4000)
    switched = [d for d in made if d.kind == "randomised"]
    assert len(switched) / 4000 == pytest.approx(0.2, abs=0.025)  # four standard deviations
    assert {d.kind for d in made} == {"expert", "randomised"}
    assert all((d.switch >= 0) == (d.kind == "randomised") for d in made)


def test_the_switch_is_uniform_over_the_episode():
    steps = np.array([d.switch for d in demonstrations(4000, randomise=1.0)])
    assert steps.min() == 0 and steps.max() == 65
    assert np.histogram(steps, 6, (0, 66))[0] == pytest.approx(4000 / 6, rel=0.2)


def test_jitter_is_smooth_noise_on_what_the_arm_is_asked_for():
    calm, *shaken = (demonstrations(40, randomise=0.0, jitter=jitter) for jitter in (0.0, 0.2, 0.2))
    simulator = Still()
    truth = calm[0].act(simulator)
    noise = np.array([[d.act(simulator) - truth for _ in range(60)] for d in shaken[0]])  # (M, T, A)
    again = np.array([[d.act(simulator) - truth for _ in range(60)] for d in shaken[1]])
    np.testing.assert_array_equal(noise, again)
    assert (noise[..., 6] == 0.0).all() and (np.abs(truth + noise) <= 1.0).all()
    sizes = noise[..., :2].std((1, 2))
    assert sizes.min() > 0.0 and sizes.max() < 0.25 and np.ptp(sizes) > 0.08  # each episode has its own
    steps = np.diff(noise[..., :2], axis=1).std() / noise[..., :2].std()
    assert 0.3 < steps < 0.6  # of white noise 1.4


@pytest.mark.parametrize(("share", "kind"), [(0.0, "expert"), (1.0, "randomised")])
def test_the_shares_limits(share, kind):
    assert {d.kind for d in demonstrations(50, randomise=share)} == {kind}


def test_actions_are_the_experts_until_the_switch_and_random_after():
    seed = next(i for i, d in enumerate(demonstrations(200, randomise=1.0)) if 5 < d.switch < 60)
    behaviour = demonstrations(seed + 1, randomise=1.0)[seed]
    twin = np.random.default_rng([seed, 0])
    expert = TASK.expert(twin)
    still = Still()
    expected = expert.act(still.poses(), still.goal())
    actions = []
    while not behaviour.done(False):
        actions.append(behaviour.act(still))
    actions = np.array(actions)
    assert len(actions) == 66
    np.testing.assert_array_equal(actions[: behaviour.switch], np.tile(expected, (behaviour.switch, 1)))
    tail = actions[behaviour.switch :]
    assert (np.abs(tail) <= 1).all() and len(np.unique(tail[:, 0])) == len(tail)


def test_an_expert_lingers_after_success():
    behaviour = demonstrations(1, randomise=0.0, linger=3)[0]
    ends = [behaviour.done(success) for success in (False, False, True, True, True, True)]
    assert ends == [False] * 5 + [True]


def test_practice_is_a_function_of_its_generator_and_acts_within_limits():
    still = Still()

    def actions(seed):
        practice = Practice(TASK, np.random.default_rng(seed))
        return np.array([practice.act(still) for _ in range(80)])

    one, again, other = actions(1), actions(1), actions(2)
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    for row in (one, other):
        assert row.shape == (80, 7) and np.isfinite(row).all() and np.abs(row).max() <= 1


def test_practice_shows_idle_hands_and_shut_fingers():
    still = Still()
    rows = np.concatenate(
        [[p.act(still) for _ in range(80)] for p in (Practice(TASK, np.random.default_rng(s)) for s in range(40))]
    )
    idle = (np.abs(rows[:, :6]) == 0).all(1)
    assert 0.03 < idle.mean() < 0.3
    assert (idle & (rows[:, -1] == 0)).any()
    assert 0.2 < (rows[:, -1] < 0).mean() < 0.8
    assert not Practice(TASK, np.random.default_rng(0)).done(True)


def test_a_toss_is_the_expert_and_then_random_actions():
    still, lengths = Still(), []
    for seed in range(40):
        practice = Practice(TASK, np.random.default_rng(seed))
        practice._simulator = still
        actions = np.array(list(practice._toss()))
        lengths.append(len(actions))
        expert = int((np.abs(actions - actions[0]) < 1e-12).all(1).sum())  # in a still world it repeats itself
        assert 3 <= expert <= 35
        np.testing.assert_array_equal(actions[:expert], np.tile(actions[0], (expert, 1)))
        tail = actions[expert:]
        assert 10 <= len(tail) <= 25 and (np.abs(tail) <= 1).all()
    assert 13 <= min(lengths) < max(lengths) <= 60


def run_segment(simulator, kind, seed, task=STACK):
    """Poses (T + 1, E, 7) of one segment of practice from the episode of ``seed``."""
    simulator.reset(seed)
    practice = Practice(task, np.random.default_rng(seed))
    practice._simulator = simulator
    poses = [simulator.poses()]
    for action in getattr(practice, kind)():
        simulator.step(action)
        poses.append(simulator.poses())
    return np.array(poses)


def test_pushes_move_objects_without_lifting_them(stack_simulator):
    moved = []
    for seed in range(4):
        poses = run_segment(stack_simulator, "_push", seed)
        moved.append(np.linalg.norm(poses[-1, 3:, :2] - poses[0, 3:, :2], axis=-1).max())
        assert poses[:, 3:, 2].max() < 0.06
    assert np.mean(np.array(moved) > 0.01) >= 0.5, moved


def test_drops_let_an_object_fall_from_mid_air(simulator):
    drops = []
    for seed in range(4):
        heights = run_segment(simulator, "_drop", seed, TASK)[:, 3, 2]
        drops.append(heights.max() > 0.035 and heights[-1] < heights.max() - 0.015)
    assert sum(drops) >= 1, drops


def test_every_object_is_practised_with():
    practice = Practice(STACK, np.random.default_rng(0))
    names = [practice._any_object() for _ in range(200)]
    assert {*names} == {"cube_a", "cube_b"} and 60 < names.count("cube_a") < 140


def test_practice_needs_no_tool():
    """A robot whose tool no script knows is moved by its expert and by noise."""
    robot = replace(TASK.robot, tool=None, action=None)
    practice = Practice(replace(TASK, robot=robot), np.random.default_rng(0))
    still = Still()
    actions = np.array([practice.act(still) for _ in range(200)])
    assert np.isfinite(actions).all() and len(np.unique(actions.round(4), axis=0)) > 50


def test_perturbed_scenes_start_at_rest_and_inside_nothing(stack_simulator):
    """What starts inside something is thrown out: in the first step nothing is faster than a fall."""
    moved, fell = [], 0
    for seed in range(10):
        stack_simulator.reset(seed)
        before = stack_simulator.poses()
        perturb(stack_simulator, STACK.layout, np.random.default_rng(seed), Extents(stack_simulator), STACK.robot.tool)
        start = stack_simulator.poses()
        np.testing.assert_array_equal(start[:3], before[:3])
        moved.append((np.abs(start - before)[3:].max(-1) > 1e-6).sum())
        stack_simulator.step(np.array([0, 0, 0, 0, 0, 0, 1], np.float32))
        first = stack_simulator.poses()[3:, :3] - start[3:, :3]
        assert np.linalg.norm(first, axis=-1).max() < 0.0155, (seed, first)
        fell += (first[:, 2] < -0.014).any()
    assert moved == [1] * 10
    assert 1 <= fell <= 9


def test_about_a_seventh_of_practice_episodes_start_unusually(stack_simulator):
    class Counting:
        placed = 0

        def place(self, name, pose):
            Counting.placed += 1

        def __getattr__(self, name):
            return getattr(stack_simulator, name)

    class Full(Counting):
        def reset(self, seed): ...

    for seed in range(300):
        Practice(STACK, np.random.default_rng(seed)).start(Full())
    assert 25 <= Counting.placed <= 65
    for seed in range(20):
        Practice(STACK, np.random.default_rng(seed), unusual=0.0).start(Full())
        Demonstration(STACK, np.random.default_rng(seed)).start(Full())
    assert Counting.placed <= 65


def test_a_simulator_that_cannot_place_bodies_starts_as_it_is():
    perturb(Still(), TASK.layout, np.random.default_rng(0), Extents(Still()))


def test_a_switch_comes_within_the_experts_length():
    steps = [Demonstration(STACK, np.random.default_rng(s), randomise=1.0).switch for s in range(500)]
    assert 90 < max(steps) < STACK.expert_steps and min(steps) < 5


@pytest.mark.parametrize(("length", "begun"), [(240, True), (99, False)])
def test_practice_of_a_long_task_starts_anywhere_along_the_experts_way(length, begun):
    task = replace(TASK, expert_steps=length)

    def start(seed, still):
        Practice(task, np.random.default_rng(seed), unusual=0.0).start(still)

    check_starts(start, length, begun)


def test_a_mirrored_scene_has_its_furniture_on_the_other_side(mug_simulator):
    mug_simulator.reset(5)
    before, joints = mug_simulator.poses(), mug_simulator.joints()
    mirror(mug_simulator, MUG)
    after = mug_simulator.poses()
    np.testing.assert_allclose(after[:3], before[:3], atol=1e-4)
    np.testing.assert_allclose(mug_simulator.joints(), joints, atol=1e-6)
    np.testing.assert_allclose(after[3:, :3], before[3:, :3] * [1, -1, 1], atol=1e-4)
    assert before[3, 1] > 0.1  # the cabinet
    behaviour = Demonstration(MUG, np.random.default_rng(5), randomise=0.0)
    for _ in range(150):
        mug_simulator.step(behaviour.act(mug_simulator))
    drawn = mug_simulator.poses()[4] - after[4]
    assert np.linalg.norm(drawn[:3]) > 0.1  # the expert opened the drawer


def test_a_mirrored_behaviour_is_the_same_one_in_the_mirrored_scene(mug_simulator):
    def act(mirrored):
        mug_simulator.reset(5)
        behaviour = Demonstration(MUG, np.random.default_rng(5), randomise=0.0)
        behaviour = Mirrored(MUG, behaviour) if mirrored else behaviour
        behaviour.start(mug_simulator)
        return behaviour.kind, behaviour.switch, mug_simulator.poses()[3, 1], behaviour.act(mug_simulator)

    (kind, switch, left, towards), (other_kind, other_switch, right, away) = act(False), act(True)
    assert (kind, switch) == (other_kind, other_switch) == ("expert", -1)
    assert right == pytest.approx(-left, abs=1e-4) and towards[1] > 0 > away[1]


def test_a_scene_that_cannot_be_mirrored_is_refused():
    class Fixed(Still):
        def restore(self, scene, rebuild=True): ...

    with pytest.raises(SceneError, match="PickCube cannot be mirrored: 'cube' would be at .*, and is at"):
        mirror(Fixed(), TASK)


@pytest.mark.parametrize("kind", ["demonstration", "practice"])
def test_a_share_of_the_episodes_is_mirrored(kind, tmp_path):
    def count(share):
        config = CollectConfig(task="MugCleanup", mirrored=share, out=tmp_path)
        make = Shard(tmp_path / "x.npz", range(400), kind, config).behaviours(MUG)
        return sum(isinstance(make(seed), Mirrored) for seed in range(400))

    assert count(0.0) == 0 and count(1.0) == 400
    assert 70 < count(0.25) < 130


@pytest.mark.parametrize(("length", "begun"), [(240, True), (99, False)])
def test_planned_episodes_of_a_long_task_start_anywhere_along_the_experts_way(length, begun):
    task, known = replace(TASK, expert_steps=length), []

    class Planner:
        def reset(self, seed): ...

        def act(self, scene):
            known.append(scene.last_action is not None)
            return np.zeros(7)

    def start(seed, still):
        planned = OnPolicy(task, Planner(), seed)
        planned.start(still)
        planned.act(still)
        assert known.pop() == (still.steps > 0)

    check_starts(start, length, begun)
