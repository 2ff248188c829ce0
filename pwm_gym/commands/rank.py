"""``pwm-gym rank``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from pwm_gym.commands.crew import crew
from pwm_gym.commands.numbers import check_least

__all__ = ["Rank"]


@dataclass(frozen=True)
class Rank:
    """Compare policies in the world model and in the simulator, from the same scenes: does the model order them right?

    A killed run goes on where it was.
    """

    policies: tyro.conf.Positional[tuple[str, ...]]
    """Folders of ``pwm-gym train-agent`` (their ``snapshots/``, too), "expert:0.3" (the scripted expert with noise),
    "mppi:64" (the planner with so many samples; "mppi:64@FOLDER" in another checkpoint's model), "random"."""
    task: str = "PickCube"
    """Registered task."""
    scenes: int = 200
    """Scenes, the same for both worlds."""
    checkpoint: str = "default"
    """The world model's folder or a shipped checkpoint's name."""
    max_steps: int | None = None
    """Actions of an episode at most; None takes the task's limit."""
    floor: bool = True
    """Whether to compare the simulator with itself on other scenes, too."""
    out: Path = Path("runs/ranking")
    """Folder of what is finished."""
    workers: int = 1
    """Policies at once."""
    ray: str | None = None
    """Ray cluster whose machines run them instead: "auto", "local" or HOST:PORT (the extra "ray")."""
    json: Path | None = None
    """Where to write the results."""
    picture: Path | None = None
    """Where to draw success in the model against success in the simulator."""

    def run(self) -> None:
        """Run all episodes, print the table and draw it."""
        import pwm_gym  # noqa: F401  (registers)
        from pwm_gym.agents.ranking import rank_contestants
        from pwm_gym.evaluation import write_results
        from pwm_gym.tasks import get_task
        from pwm_gym.viewer.ranking import draw_ranking

        check_least(self, scenes=1, workers=1)
        task = get_task(self.task)
        where = (self.checkpoint, self.max_steps, self.floor, crew(self.workers, self.ray))
        table = rank_contestants(self.policies, task.name, self.out, self.scenes, *where)
        _print(table)
        if self.json is not None:
            write_results(self.json, table)
        if self.picture is not None:
            print(draw_ranking(table, self.picture))


def _print(table: dict[str, Any]) -> None:
    """The rates, and how well they agree."""
    from pwm_gym.evaluation.ranking import measure_text

    print(f"\n{table['task']}: {table['policies']} policies from {table['scenes']} scenes")
    print(f"  {'model':>6} {'sim':>6}  policy")
    for row in sorted(table["rows"], key=lambda row: row["simulator"]):
        print(f"  {row['model']:6.1%} {row['simulator']:6.1%}  {row['name']}")
    for label, found in (("model", table), ("floor", table.get("floor"))):
        if found is not None:
            told = [f"{key} {measure_text(found[key])}" for key in ("pearson", "spearman", "mmrv")]
            print(f"  {label}: {', '.join(told)}; {found['agreement']:.1%} of the episodes end alike")
