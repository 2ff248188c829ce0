"""Episodes of OGBench's Cube tasks that start in the midst of play, with a goal that play reaches a little later.

This is the protocol of the figures that stable-worldmodel publishes for OGBench's cube (its ``scripts/plan``): a start
is any state of an offline data set with 25 more steps behind it, velocities included, the goal is where the cube is 25
steps later, the budget is 50 steps, and an episode succeeds at the first step that ends with the cube within 4 cm of
that place. Starts from which the cube moves less than 4 cm are among them, and nothing has to be done there.

The data set is not needed here: the episode of a seed is played anew, by the recipe of the script that collects such
data there (``scripts/data/collect_cube.py``): OGBench's ``CubeMarkovOracle`` in 200 steps of its environment's mode for
data collection, a new target whenever it is done, and Gaussian noise on the actions, of a scale that is drawn for each
episode.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["AHEAD", "LENGTH", "PlayStart", "start_in_play"]

AHEAD = 25
"""Steps from an episode's start to the state whose cubes' places are its goal."""
LENGTH = 200
"""Steps of play that a start is drawn from."""

_STEP = 0.4  # metres: length of the way that the oracle asks for at least
_NOISE, _NOISE_SCALES = 0.1, np.array([1.0, 1.0, 1.0, 3.0, 10.0])  # largest share of an action's unit; components
_STACKED = 0.25  # largest probability of a target on top of another cube
_OWN_STREAM = 1  # beside the seed: the environment draws from a generator of the seed itself


@dataclass(frozen=True)
class PlayStart:
    """What came before the start of an episode, and where the cubes shall go."""

    positions: np.ndarray
    """``qpos`` (3, nq) at the start and one and two steps before it; at a start of play itself that of the start."""
    action: np.ndarray | None
    """OGBench's action (5,) that led to the start; None at a start of play itself."""
    goal: np.ndarray
    """Where the cubes shall be (3 K,), metres."""


def start_in_play(env: Any, seed: int) -> PlayStart:
    """Bring OGBench's environment to where the episode of ``seed`` starts, with its velocities.

    Args:
        env: a ``CubeEnv``.
        seed: decides everything: scene, targets, noise and step of the start.
    """
    rng = np.random.default_rng((int(seed), _OWN_STREAM))
    with _collecting(env):
        player = _Player(env, int(seed), rng)
        before = deque([_positions(env)] * 3, maxlen=3)  # newest first
        action = None
        for _ in range(int(rng.integers(LENGTH - AHEAD))):
            action = player.step()
            before.appendleft(_positions(env))
        start = _state(env)
        for _ in range(AHEAD):
            player.step()
    goal = np.concatenate([env.data.joint(f"object_joint_{k}").qpos[:3] for k in range(env._num_cubes)])
    _set_state(env, start)
    return PlayStart(np.stack(before), action, goal)


class _Player:
    """OGBench's oracle, which brings one cube after another to a random place, with noise on its actions.

    Args:
        env: in its mode for data collection; it is reset.
        seed: of the environment's own draws.
        rng: of everything else.
    """

    def __init__(self, env: Any, seed: int, rng: np.random.Generator) -> None:
        from ogbench.manipspace.oracles.markov.cube_markov import CubeMarkovOracle

        self._env, self._rng = env, rng
        self._oracle = CubeMarkovOracle(env=env, min_norm=_STEP)
        self._noise = rng.uniform(0.0, _NOISE) * _NOISE_SCALES
        self._stacked = rng.uniform(0.0, _STACKED)
        _, self._info = env.reset(seed=seed)
        self._begin()

    def _begin(self) -> None:
        """Let the oracle begin with a new target, as its own reset does, which draws from NumPy's global generator."""
        self._oracle._done, self._oracle._step = False, 0
        self._oracle._final_pos = self._rng.uniform(*self._env._arm_sampling_bounds)
        self._oracle._final_yaw = self._rng.uniform(-np.pi, np.pi)

    def step(self) -> np.ndarray:
        """Make one step, and give its action (5,)."""
        action = self._oracle.select_action(None, self._info) + self._rng.normal(0.0, self._noise)
        action = np.clip(action, -1.0, 1.0)
        if self._oracle.done:
            self._env.set_new_target(p_stack=self._stacked)
            self._begin()
        self._info = self._env.step(action)[-1]
        return action


@contextmanager
def _collecting(env: Any) -> Iterator[None]:
    """The environment in its mode for data collection."""
    mode, env._mode = env._mode, "data_collection"
    try:
        yield
    finally:
        env._mode = mode


def _positions(env: Any) -> np.ndarray:
    return env.data.qpos.copy()


def _state(env: Any) -> np.ndarray:
    """All that MuJoCo's future depends on."""
    import mujoco

    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(env.model, kind))
    mujoco.mj_getState(env.model, env.data, state, kind)
    return state


def _set_state(env: Any, state: np.ndarray) -> None:
    import mujoco

    mujoco.mj_setState(env.model, env.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_forward(env.model, env.data)
