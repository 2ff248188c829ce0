"""Many worlds of a MuJoCo simulator's model at once, stepped by MuJoCo Warp: on a GPU where there is one."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.sim.mujoco.adapter import MujocoSimulator
from pwm_gym.sim.mujoco.worlds import SetsControls
from pwm_gym.sim.protocol import Simulator

__all__ = ["WarpWorlds", "import_warp"]

_DATA = ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat")
"""What of a world's data its future depends on."""
_MOVED = ("qpos", "qvel", "act")
"""What of it the model's steps change."""
_MODEL = ("body_pos", "body_quat", "site_pos")
"""What of the model episodes may start with differently."""
_ROWS = 4  # constraints a contact at most, of pyramidal cones in three dimensions
_BOUND = 1e10  # beyond which MuJoCo takes a state for diverged, too


class WarpWorlds:
    """N worlds of a simulator's model; the physics alone is Warp's, in float32.

    Resets, what actions mean, poses, joints, goals, rewards and contacts are the simulator's own: :meth:`view` puts one
    world's state into it. So whoever acts in a simulator can act in each of the worlds, in turn.

    Each control step begins with a cold solver, as the simulator's does. Where a geom has a margin, Warp supports
    neither of MuJoCo's ``nativeccd`` and ``multiccd``: both are off then, and meshes touch in one point.

    Args:
        simulator: shows the worlds; nobody else may step it meanwhile.
        worlds: N.
        device: of Warp, such as "cuda:0" or "cpu"; None takes Warp's preferred one.
        contacts: room for contacts a world, and for four times as many constraints.

    Raises:
        PwmGymError: MuJoCo Warp is not installed or does not support the model, the simulator is not MuJoCo's, or its
            world steps itself as a whole.
    """

    def __init__(self, simulator: Simulator, worlds: int, device: str | None = None, contacts: int = 64) -> None:
        self._engine, warp = import_warp()
        if worlds < 1 or contacts < 1:
            raise PwmGymError(f"worlds={worlds}, contacts={contacts}; expected 1 or more of each")
        self.simulator = _mujoco(simulator)
        self._world = _driven(self.simulator)
        self._contacts = contacts
        model, data = self.simulator.model, self.simulator.data
        self._state = {name: _copies(getattr(data, name), worlds) for name in _DATA}
        self._places = {name: _copies(getattr(model, name), worlds) for name in _MODEL}
        self._goals = [self._world.goal() for _ in range(worlds)]
        self._running = np.zeros(worlds, bool)
        self._settled = np.ones(worlds, bool)
        self._placed = False
        self._device = warp.ScopedDevice(warp.get_device(device))
        with self._device:
            self._model, self._data = self._put(worlds)

    def _put(self, worlds: int) -> tuple[Any, Any]:
        """Warp's model and data."""
        model = _without_margins_refused(self.simulator.model)
        room = {"nconmax": self._contacts, "njmax": _ROWS * self._contacts}
        try:
            batched = {name: worlds for name in _MODEL if getattr(model, name).size}
            return self._engine.put_model(model, batched), self._engine.make_data(model, nworld=worlds, **room)
        except (NotImplementedError, ValueError) as error:
            raise PwmGymError(f"MuJoCo Warp does not support the model: {error}") from error

    def __len__(self) -> int:
        return len(self._running)

    # One world at a time, by the simulator ------------------------------------------------------------------------

    def begin(self, world: int, seed: int) -> MujocoSimulator:
        """Start the episode of ``seed`` in a world, and show it; :meth:`keep` what is changed of it then."""
        self.simulator.reset(seed)
        self.keep(world)
        return self.simulator

    def keep(self, world: int) -> None:
        """Take the simulator's present state for that of a world."""
        for name, values in self._state.items():
            values[world] = getattr(self.simulator.data, name)
        for name, values in self._places.items():
            values[world] = getattr(self.simulator.model, name)
        self._goals[world] = self._world.goal()
        self._running[world] = self._settled[world] = True
        self._placed = False

    def end(self, world: int) -> None:
        """Leave a world alone until the next :meth:`begin`."""
        self._running[world] = False

    def view(self, world: int) -> MujocoSimulator:
        """The simulator, in a world's state."""
        self._load(world)
        if not self._settled[world]:
            self._world.settle()
            for name in _MOVED:
                self._state[name][world] = getattr(self.simulator.data, name)
            self._settled[world] = True
        return self.simulator

    def _load(self, world: int) -> None:
        import mujoco

        model, data = self.simulator.model, self.simulator.data
        for name, values in self._places.items():
            getattr(model, name)[:] = values[world]
        for name, values in self._state.items():
            getattr(data, name)[:] = values[world]
        self._world.set_goal(self._goals[world])
        mujoco.mj_forward(model, data)

    def drive(self, world: int, action: np.ndarray) -> None:
        """Ask for an action (A,) in [-1, 1] in the world that was shown last."""
        self._world.drive(np.asarray(action, np.float32))
        for name in ("ctrl", "mocap_pos", "mocap_quat"):
            self._state[name][world] = getattr(self.simulator.data, name)

    # All at once, by Warp -----------------------------------------------------------------------------------------

    def advance(self) -> None:
        """One control step of all worlds.

        Raises:
            PwmGymError: a world diverged, or has more contacts than there is room for.
        """
        with self._device:
            self._send()
            for _ in range(self._world.frame_skip):
                self._engine.step(self._model, self._data)
            self._receive()

    def _send(self) -> None:
        if not self._placed:
            for name, values in self._places.items():
                _assign(getattr(self._model, name), values)
            self._placed = True
        for name, values in self._state.items():
            _assign(getattr(self._data, name), values)
        self._data.qacc_warmstart.zero_()
        self._data.overflow.zero_()

    def _receive(self) -> None:
        running = self._running
        overflow = np.flatnonzero(running & (self._data.overflow.numpy() != 0))
        if len(overflow):
            raise PwmGymError(f"world {overflow[0]} has no room for its contacts: contacts={self._contacts}")
        for name in _MOVED:
            values = getattr(self._data, name).numpy().astype(float)
            with np.errstate(invalid="ignore"):
                wrong = running & ~(np.abs(values) < _BOUND).all(-1)
            if wrong.any():
                raise PwmGymError(
                    f"the simulation of world {np.flatnonzero(wrong)[0]} diverged: {name} is out of bounds"
                )
            self._state[name][running] = values[running]
        self._settled[running] = False

    # Whole batches ------------------------------------------------------------------------------------------------

    def reset(self, seeds: Sequence[int]) -> None:
        """Start the episodes of N seeds."""
        if len(seeds) != len(self):
            raise PwmGymError(f"{len(seeds)} seeds; expected one for each of {len(self)} worlds")
        for world, seed in enumerate(seeds):
            self.begin(world, seed)

    def step(self, actions: np.ndarray) -> None:
        """Apply actions (N, A) in [-1, 1] for one control step."""
        expected = len(self), self.simulator.action_size
        if np.shape(actions) != expected:
            raise PwmGymError(f"the actions have shape {np.shape(actions)}; expected {expected}")
        for world, action in enumerate(actions):
            self.view(world)
            self.drive(world, action)
        self.advance()

    def poses(self) -> np.ndarray:
        """Entity poses (N, E, 7) in the base's frame: metres, quaternions wxyz."""
        return np.stack([self.view(world).poses() for world in range(len(self))])

    def joints(self) -> np.ndarray:
        """Joint positions and velocities (N, 2, J) float32, as the simulator's."""
        return np.stack([self.view(world).joints() for world in range(len(self))])


def import_warp() -> tuple[Any, Any]:
    """MuJoCo Warp and Warp.

    Raises:
        PwmGymError: they are not installed.
    """
    try:
        import mujoco_warp
        import warp
    except ImportError as error:
        raise PwmGymError(f"{error}; MuJoCo Warp is needed: pip install 'pwm-gym[warp]'") from error
    return mujoco_warp, warp


def _mujoco(simulator: Simulator) -> MujocoSimulator:
    if not isinstance(simulator, MujocoSimulator):
        raise PwmGymError(f"the simulator is a {type(simulator).__name__}; expected a MujocoSimulator for MuJoCo Warp")
    return simulator


def _driven(simulator: MujocoSimulator) -> Any:
    """The simulator's world, whose model something else can step."""
    world = simulator.world
    if not isinstance(world, SetsControls):
        raise PwmGymError(
            f"a {type(world).__name__} steps its model itself; MuJoCo Warp expects a world with `drive` and `settle`"
        )
    return world


def _without_margins_refused(model: Any) -> Any:
    """The model, or a copy with what Warp does not support beside margins switched off."""
    import mujoco

    if not model.geom_margin.any() and not model.pair_margin.any():
        return model
    bits = mujoco.mjtDisableBit
    model = copy.copy(model)
    model.opt.disableflags |= int(bits.mjDSBL_NATIVECCD) | int(bits.mjDSBL_MULTICCD)
    return model


def _copies(values: np.ndarray, worlds: int) -> np.ndarray:
    """(N, ...) float64."""
    return np.repeat(np.asarray(values, float)[None], worlds, 0)


def _assign(array: Any, values: np.ndarray) -> None:
    if values.size:
        array.assign(values.astype(np.float32))
