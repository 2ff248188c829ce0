"""``pwm-gym envs``."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Envs"]


@dataclass(frozen=True)
class Envs:
    """List the registered environments."""

    def run(self) -> None:
        """Print one line an environment."""
        import gymnasium as gym

        import pwm_gym  # noqa: F401  (registers)

        for name, spec in sorted(gym.registry.items()):
            if name.startswith("pwm/"):
                kind = "simulator twin" if name.endswith("Sim-v0") else "world model"
                print(f"{name:24s} {kind:16s} {spec.max_episode_steps:4d} steps")
