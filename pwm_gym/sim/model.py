"""A simulator in the place of a world model: what a planner could reach if its model were true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout, RigidState, Scene, State, stack
from pwm_gym.scene.se3 import matrix_from_pose7, pose7_from_matrix
from pwm_gym.sim.protocol import Simulator

__all__ = ["SimulatorModel"]


class SimulatorModel:
    """Steps a simulator from each state in turn; implements :class:`pwm_gym.dynamics.WorldModel`.

    Where a task's objects differ between episodes, a state does not tell which it is of: :meth:`meet` its scene first,
    as :class:`pwm_gym.planning.Agent` does.

    Args:
        simulator: of the task, which is reset; another one than that which the plans are executed in.
        layout: the scene's entities.
        task: the task's name.
        goal_size: G.
    """

    def __init__(self, simulator: Simulator, layout: Layout, task: str, goal_size: int) -> None:
        self.links, self.layout = layout.robot(), layout
        self.action_size, self._simulator = simulator.action_size, simulator
        self._task, self._goal = task, np.zeros(goal_size, np.float32)
        self._assets: dict[bytes, tuple[str, ...]] = {}
        simulator.reset(0)
        self._varied = simulator.assets() != layout.names  # an asset has its entity's name where it is always the same

    def meet(self, scenes: Sequence[Scene]) -> None:
        """Take states with the clouds of these scenes as ones of their assets, until it meets others."""
        self._assets = {_mark(scene.layout, scene.clouds): scene.assets for scene in scenes}

    def prepare(self, state: State) -> RigidState:
        """The state itself.

        Raises:
            PwmGymError: it has no joint positions, which a simulator starts from.
        """
        if not isinstance(state, RigidState) or state.joints is None:
            raise PwmGymError("the state has no joint positions; a simulator starts only from those")
        return replace(state, error=None)

    def step(self, state: State, action: Tensor) -> RigidState:
        """State (B,) one control step after action (B, A)."""
        return self.rollout(state, action.unsqueeze(1))[:, 0]

    def rollout(self, state: State, actions: Tensor) -> RigidState:
        """States (B, H) from ``state`` (B,) under ``actions`` (B, H, A)."""
        # The simulator's own tensors live on: made in a planner's inference mode, they could not be changed outside it.
        with torch.inference_mode(False), torch.no_grad():
            start = self.prepare(state)
            commands = actions.detach().cpu().numpy()
            futures: list[State] = [self._follow(start[b], commands[b]) for b in range(len(commands))]
            joined: RigidState = stack(futures, 0)  # type: ignore[assignment]
        return joined

    def _follow(self, state: RigidState, actions: np.ndarray) -> RigidState:
        """States (H,) after each of the actions (H, A) from ``state`` without a batch.

        Raises:
            PwmGymError: the state is of no scene that it met, and the task's objects differ between episodes.
        """
        poses, joints = pose7_from_matrix(state.frames.double()).numpy(), state.joints
        assert joints is not None
        clouds = state.clouds.numpy()
        assets = self._assets.get(_mark(state.layout, clouds), ())
        if self._varied and not assets:
            raise PwmGymError(
                f"the state is of no scene that the simulator met, and the objects of {self._task} differ between "
                "episodes; expected meet() to be given its scene, with assets, first"
            )
        scene = Scene(self._task, state.layout, clouds, poses, self._goal, joints.numpy(), assets=assets)
        self._simulator.restore(scene, rebuild=False)
        future: list[State] = []
        for action in actions:
            self._simulator.step(action)
            frames = matrix_from_pose7(torch.as_tensor(self._simulator.poses())).float()
            state = state.advance(frames, torch.as_tensor(self._simulator.joints()))
            future.append(state)
        joined: RigidState = stack(future, 0)  # type: ignore[assignment]
        return joined


def _mark(layout: Layout, clouds: np.ndarray) -> bytes:
    """What canonical clouds (N, 3) are known by: each entity's first point, which coarser clouds have, too."""
    return np.asarray(clouds[[e.start for e in layout]], np.float32).tobytes()
