"""What steps a MuJoCo model: an XML of one's own, or an environment of Gymnasium-Robotics."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pwm_gym.errors import PwmGymError, check_whole
from pwm_gym.sim.mujoco.structure import label

__all__ = ["RoboticsWorld", "SetsControls", "World", "XmlWorld", "make_environment"]

_NO_TIME_LIMIT = 1_000_000  # the package's environments own their limits


class World(Protocol):
    """A MuJoCo model with its data, and the meaning of actions in it. Everything is in MuJoCo's world frame."""

    model: Any
    """``mujoco.MjModel``."""
    data: Any
    """``mujoco.MjData``."""
    action_size: int
    period: float
    """Seconds per control step."""

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``."""

    def clear(self) -> None:
        """Go to a state that is always the same, with nothing left of what was before."""

    def step(self, action: np.ndarray) -> None:
        """Apply an action (A,) in [-1, 1] for one control step."""

    def goal(self) -> np.ndarray:
        """Goal (G,) of the episode; one of three values is a position, metres."""

    def set_goal(self, goal: np.ndarray) -> None:
        """Make ``goal`` (G,) that of the episode."""

    def close(self) -> None:
        """Free what it holds; calling it twice is harmless."""


@runtime_checkable
class SetsControls(Protocol):
    """A world whose control step has three parts, so that something else can step its model: :meth:`drive`,
    ``frame_skip`` steps of the model, :meth:`settle`."""

    frame_skip: int
    """MuJoCo's steps in one control step."""

    def drive(self, action: np.ndarray) -> None:
        """Set the controls and the mocap bodies' poses that an action (A,) in [-1, 1] asks for, and nothing else."""

    def settle(self) -> None:
        """Change what the world changes after the model's steps."""


class XmlWorld:
    """A model of an XML, driven through its actuators.

    Args:
        xml: path of the file, or its text.
        act: (model, data, action (A,)) -> controls (nu,); by default each component spans its actuator's range.
        action_size: A, where ``act`` is given; by default there is one component an actuator.
        frame_skip: MuJoCo's steps in one control step.
        start: (model, data, rng) -> goal (G,) or None; sets positions where episodes shall start from different ones.
            By default they start from the model's first keyframe, or else from its reference.

    Raises:
        FileNotFoundError: there is no such file.
        PwmGymError: MuJoCo cannot read it, a size is no whole number, or without ``act`` some actuator has no range or
            there is another number of them.
    """

    def __init__(
        self,
        xml: str | Path,
        act: Callable[[Any, Any, np.ndarray], np.ndarray] | None = None,
        action_size: int | None = None,
        frame_skip: int = 20,
        start: Callable[[Any, Any, np.random.Generator], np.ndarray | None] | None = None,
    ) -> None:
        import mujoco

        frame_skip = check_whole("frame_skip", frame_skip, 1)
        self.model = _load(xml)
        self.data = mujoco.MjData(self.model)
        self.period = float(self.model.opt.timestep) * frame_skip
        size = int(self.model.nu) if action_size is None else check_whole("action_size", action_size, 0)
        if act is None and size != self.model.nu:
            raise PwmGymError(
                f"action_size={size}; expected {self.model.nu}, one for each actuator, or a function `act`"
            )
        self.action_size = size
        self.direct = act is None
        """Whether actions span the actuators' ranges."""
        self._act = self._spread if act is None else act
        self._start, self.frame_skip = start, frame_skip
        self._goal = np.zeros(0)
        if act is None:
            self._check_ranges()

    def _check_ranges(self) -> None:
        for k in range(self.model.nu):
            if not self.model.actuator_ctrllimited[k]:
                name = label(self.model.actuator(k))
                raise PwmGymError(f"actuator {name} has no ctrlrange; expected one, or a function `act`")

    @staticmethod
    def _spread(model: Any, data: Any, action: np.ndarray) -> np.ndarray:
        low, high = model.actuator_ctrlrange.T
        return low + 0.5 * (action + 1.0) * (high - low)

    def reset(self, seed: int) -> None:
        """Start the episode of ``seed``.

        Raises:
            PwmGymError: ``start`` returns no goal.
        """
        self.clear()
        if self._start is not None:
            found = self._start(self.model, self.data, np.random.default_rng(seed))
            goal = np.zeros(0) if found is None else _numbers(found)
            if goal is None or goal.ndim != 1:
                raise PwmGymError(f"`start` returned {found!r}; expected a goal (G,) or None")
            self._goal = goal

    def clear(self) -> None:
        """Go to the first keyframe, or else to the model's reference."""
        import mujoco

        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        else:
            mujoco.mj_resetData(self.model, self.data)

    def step(self, action: np.ndarray) -> None:
        """Apply an action (A,) in [-1, 1] for one control step."""
        import mujoco

        self.drive(action)
        mujoco.mj_step(self.model, self.data, nstep=self.frame_skip)

    def drive(self, action: np.ndarray) -> None:
        """Set the actuators' controls for an action (A,) in [-1, 1].

        Raises:
            PwmGymError: ``act`` returns something else than a finite number for each.
        """
        self.data.ctrl[:] = self._controls(self._act(self.model, self.data, action))

    def _controls(self, found: Any) -> np.ndarray:
        """What ``act`` returned as controls (nu,); None stands for those of no actuators."""
        size = int(self.model.nu)
        controls = np.zeros(0) if found is None and not size else _numbers(found)
        if controls is None or controls.shape != (size,):
            raise PwmGymError(f"`act` returned {found!r}; expected controls ({size},), one for each actuator")
        for k in np.flatnonzero(~np.isfinite(controls)).tolist():
            name = label(self.model.actuator(k))
            raise PwmGymError(f"the control of actuator {name} is {controls[k]}; expected a finite number")
        return controls

    def settle(self) -> None:
        """Nothing: the model's steps are all."""

    def goal(self) -> np.ndarray:
        """Goal (G,) that the start gave; (0,) where it gave none."""
        return self._goal.copy()

    def set_goal(self, goal: np.ndarray) -> None:
        """Make ``goal`` (G,) that of the episode."""
        self._goal = np.array(goal, float)

    def close(self) -> None:
        """Nothing: MuJoCo frees its memory itself."""


class RoboticsWorld:
    """An environment of Gymnasium-Robotics that steps its model itself.

    Args:
        env_id: Gymnasium id, such as ``"FetchPush-v4"``.

    Raises:
        PwmGymError: the environment has no MuJoCo model and data, or its episodes have no goal.
    """

    def __init__(self, env_id: str) -> None:
        self.env = make_environment(env_id)
        """The environment."""
        for name in ("model", "data", "goal", "initial_qpos"):
            if not hasattr(self.env, name):
                raise PwmGymError(f"{env_id} has no {name!r}; expected a goal environment of Gymnasium-Robotics")
        self.model, self.data = self.env.model, self.env.data
        self.action_size = int(np.prod(self.env.action_space.shape))
        self.period = float(self.env.dt)
        self.frame_skip = round(self.period / float(self.model.opt.timestep))

    def reset(self, seed: int) -> None:
        """Start the environment's episode of ``seed``."""
        self.env.reset(seed=int(seed))

    def clear(self) -> None:
        """Go to the robot's initial positions; objects are where the model puts them."""
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.env.initial_qpos

    def step(self, action: np.ndarray) -> None:
        """The environment's own step."""
        self.env.step(action)

    def drive(self, action: np.ndarray) -> None:
        """Set controls and mocap bodies as the environment's step does for an action (A,)."""
        self.env._set_action(np.clip(action, -1.0, 1.0))

    def settle(self) -> None:
        """What the environment does after its model's steps: some keep their fingers shut."""
        self.env._step_callback()

    def goal(self) -> np.ndarray:
        """The environment's desired goal (G,)."""
        return np.array(self.env.goal, float)

    def set_goal(self, goal: np.ndarray) -> None:
        """Make ``goal`` (G,) the environment's."""
        self.env.goal = np.array(goal, float)

    def close(self) -> None:
        """Free the environment's renderer; calling it twice is harmless."""
        if self.env is not None:
            self.env.close()
            self.env = None


def _numbers(found: Any) -> np.ndarray | None:
    """What a user's function returned as an array of numbers; None where it is something else."""
    try:
        return None if found is None else np.array(found, float)
    except (TypeError, ValueError):
        return None


def _load(xml: str | Path) -> Any:
    import mujoco

    text = isinstance(xml, str) and xml.lstrip().startswith("<")
    if not text and not Path(xml).exists():
        raise FileNotFoundError(f"{xml} does not exist; expected a MuJoCo XML")
    try:
        if text:
            return mujoco.MjModel.from_xml_string(xml)
        return mujoco.MjModel.from_xml_path(str(xml))
    except ValueError as error:
        raise PwmGymError(f"MuJoCo cannot read the model: {error}{_whose_file(xml, text, str(error))}") from error


def _whose_file(xml: str | Path, text: bool, complaint: str) -> str:
    """Which asset has the file that MuJoCo complains of, in words; nothing where it complains of none."""
    import mujoco

    try:
        spec = mujoco.MjSpec.from_string(xml) if text else mujoco.MjSpec.from_file(str(xml))
    except ValueError:
        return ""
    assets = {"mesh": spec.meshes, "height field": spec.hfields, "texture": spec.textures}
    named = [(len(a.file), kind, a.name) for kind, group in assets.items() for a in group if a.file in complaint]
    length, kind, name = max(named, default=(0, "", ""))  # "a.stl" is in what is said of "data.stl", too
    return f"; it is the file of {kind} {name!r}" if length else ""


def make_environment(env_id: str) -> Any:
    """An environment of Gymnasium-Robotics, without wrappers and time limit."""
    import gymnasium as gym

    with redirect_stderr(StringIO()):  # it prints a note on Adroit's rewards
        import gymnasium_robotics

        gym.register_envs(gymnasium_robotics)
    return gym.make(env_id, max_episode_steps=_NO_TIME_LIMIT, disable_env_checker=True).unwrapped
