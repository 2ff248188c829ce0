"""``pwm-gym plan``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pwm_gym.planning import MPPIConfig

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """Plan in the model, execute in the simulator, closed loop."""

    task: str = "PickCube"
    """Registered task."""
    checkpoint: str = "default"
    """A folder or a shipped checkpoint's name."""
    episodes: int = 20
    """Seeded episodes."""
    seeds: str = "plan_test"
    """Range of seeds: "plan_test", or "plan_validation" for tuning."""
    offset: int = 0
    """First seed of the range."""
    max_steps: int = 100
    """Actions an episode at most."""
    planner: MPPIConfig = field(default_factory=MPPIConfig)
    """MPPI's settings."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Run the episodes and print the success table."""
        import gymnasium as gym

        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.errors import unknown_name
        from pwm_gym.evaluation import planning_table, run_episodes, write_results
        from pwm_gym.planning import Agent
        from pwm_gym.process import prepare_process
        from pwm_gym.seeds import RANGES, seed_range

        if self.seeds not in RANGES:
            raise unknown_name("range of seeds", self.seeds, RANGES)
        prepare_process(self.threads)
        model = load_checkpoint(resolve(self.checkpoint, self.task), self.task).model
        env = gym.make(f"pwm/{self.task}Sim-v0", max_episode_steps=self.max_steps)
        seeds = seed_range(self.seeds, self.episodes, self.offset)
        runs = run_episodes(env, Agent(model, self.task, self.planner), seeds, self.max_steps)
        env.close()
        table = planning_table(runs)
        _print(self.task, table)
        if self.json is not None:
            write_results(self.json, {"planner": asdict(self.planner), "seeds": self.seeds, **table})


def _print(task: str, table: dict[str, Any]) -> None:
    low, high = table["interval"]
    latency, steps = table["plan_seconds"], table["mean_steps_of_successes"]
    print(f"\n{task}, closed loop in the simulator")
    print(f"  success          {table['successes']}/{table['episodes']}  (95 % interval {low:.0%} to {high:.0%})")
    print(f"  steps to success {steps:.1f} on average" if steps else "  steps to success -")
    print(f"  one action       {latency['median']:.2f} s median, {latency['p95']:.2f} s 95th percentile")
    if table["failed_seeds"]:
        print(f"  failed seeds     {', '.join(map(str, table['failed_seeds']))}")
