"""Windows of episodes as training reads them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import torch
from torch import Tensor

from pwm_gym.scene import Layout, RigidState

__all__ = ["Batch", "Batches"]


@dataclass(frozen=True)
class Batch:
    """Windows of H steps."""

    layout: Layout
    """Of the clouds."""
    clouds: Tensor
    """Canonical points (B, N, 3)."""
    frames: Tensor
    """Poses (B, 3, E, 4, 4) at t, t-1, t-2."""
    actions: Tensor
    """(B, H, A)."""
    following: Tensor
    """True poses (B, H, E, 4, 4) after each action."""
    joints: Tensor
    """Robot's joint positions and velocities (B, 2, J)."""
    following_joints: Tensor
    """The same (B, H, 2, J) after each action."""
    observed: Tensor | None = None
    """What a camera sees after each action (B, H, n, 3), without correspondences."""

    def to(self, device: str) -> Batch:
        """The same windows on ``device``."""
        moved: dict[str, Any] = {k: v.to(device) for k, v in vars(self).items() if isinstance(v, Tensor)}
        return replace(self, **moved)

    def state(self) -> RigidState:
        """The state that the window begins with."""
        return RigidState(self.layout, self.clouds, self.frames, self.joints)


class Batches(Protocol):
    """Where training draws its windows."""

    def sample(self, generator: torch.Generator, batch: int, horizon: int) -> Batch:
        """``batch`` windows of ``horizon`` steps."""
