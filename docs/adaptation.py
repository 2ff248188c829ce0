"""Models of the long tasks beside each other, by what they were trained on: sections of the results page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from formatting import grid, number, paragraph, read, source

_ELSEWHERE = ("evaluate_{}", "plan_{}_closed", "cloned_{}")
"""Names of results whose commands stand in other sections."""
_KITCHEN_TRAINED = """Models of one task alone began anew, for 7 and 8 minutes of one processor:

```
pwm-gym collect --task MugCleanup --episodes 110 --held-out 20 --practice 0.5
pwm-gym collect --task Coffee --episodes 90 --held-out 30 --practice 0.5
pwm-gym train --data data-sets/MugCleanup --out runs/mug-own --threads 1 --phases 1 420 192 5 400 96 15 300 48
pwm-gym train --data data-sets/Coffee --out runs/coffee-own --threads 1 --phases 1 420 192 5 400 96 15 300 48
```

The model of all three tasks went on from `kitchen` for 28 minutes beside two other processes (16 of one
processor), with few episodes:

```
pwm-gym collect --task MugCleanup --episodes 80 --held-out 2 --practice 0.5 --shard 10
pwm-gym collect --task CoffeePreparation --episodes 70 --held-out 2 --practice 0.1 --shard 10
pwm-gym collect --task Coffee --episodes 64 --held-out 8 --practice 0.0
pwm-gym train --init kitchen --data data-sets/MugCleanup data-sets/Coffee data-sets/CoffeePreparation \\
    --out runs/kitchen-three --threads 1 --learning-rate 0.001 --arm-steps 2000 --error-steps 1000 \\
    --phases 1 150 256 5 250 128 15 200 64
```

ParticleFormer+ learned from the partial clouds of the same demonstrations of MugCleanup and Coffee, for 26 minutes of
one processor; its Chamfer distances are of partial clouds. Planning with it takes seconds an action, so that it was
tried on Coffee alone, with 8 samples, horizon 5 and 150 steps.

```
pwm-gym train --data data-sets/MugCleanup data-sets/Coffee --out runs/kitchen-particleformer --model paper-small \\
    --settings rigid False entity_features True --view partial --loss hybrid --loss-points 64 --learning-rate 0.002 \\
    --threads 1 --phases 1 350 32 3 90 32 5 50 32
```
"""
_HANDS_TRAINED = """ParticleFormer+ learned from the partial clouds of both tasks' demonstrations, for 30 minutes of one
processor; its Chamfer distances are of partial clouds. Policies were cloned from each task's demonstrations.

```
pwm-gym collect --task TwoArmBoxCleanup --episodes 160 --held-out 14 --practice 0.4 --shard 10
pwm-gym collect --task TwoArmDrawerCleanup --episodes 150 --held-out 14 --practice 0.4 --shard 10
pwm-gym train --data data-sets/TwoArmBoxCleanup data-sets/TwoArmDrawerCleanup --out runs/hands-particleformer \\
    --model paper-small --settings rigid False entity_features True --view partial --loss hybrid --loss-points 64 \\
    --learning-rate 0.002 --threads 1 --phases 1 180 32 3 40 24 5 20 24
```
"""


@dataclass(frozen=True)
class _Comparison:
    """Models of some tasks beside each other."""

    title: str
    about: str
    trained: str
    tasks: Mapping[str, str]
    """Task -> stem of its results' names."""
    models: Mapping[str, tuple[str, str]]
    """Label -> names of the results of its rollouts and of its planning, "{}" for the stem."""


_COMPARISONS = (
    _Comparison(
        "A task that no training saw",
        "The paper's claim of adaptation: a model of MugCleanup and Coffee plans CoffeePreparation, which it never"
        " saw. All are planned in by the same costs from the same test seeds; cloned policies act in them.",
        _KITCHEN_TRAINED,
        {"MugCleanup": "mug_cleanup", "Coffee": "coffee", "CoffeePreparation": "coffee_preparation"},
        {
            "`kitchen`: MugCleanup and Coffee": ("evaluate_{}", "plan_{}_closed"),
            "a model of the task alone": ("evaluate_{}_own", "plan_{}_own"),
            "`kitchen`, trained further on all three": ("evaluate_{}_three", "plan_{}_three"),
            "ParticleFormer+, MugCleanup and Coffee, partial clouds": (
                "evaluate_{}_particleformer",
                "plan_{}_particleformer",
            ),
            "behaviour cloning, each task's demonstrations": ("", "cloned_{}"),
        },
    ),
    _Comparison(
        "Two arms beside learned baselines",
        "Rollouts on the same test episodes, and success from the same test seeds. Errors of a model of points add up"
        " over some 200 steps: it ends farther off than one in which nothing moves (the tasks' own sections).",
        _HANDS_TRAINED,
        {"TwoArmBoxCleanup": "two_arm_box_cleanup", "TwoArmDrawerCleanup": "two_arm_drawer_cleanup"},
        {
            "`two-hands`": ("evaluate_{}", "plan_{}_closed"),
            "ParticleFormer+, partial clouds": ("evaluate_{}_particleformer", ""),
            "behaviour cloning, each task's demonstrations": ("", "cloned_{}"),
        },
    ),
)


def adaptation() -> str:
    """Rollouts and planning of each model on each task, a section a comparison."""
    return "\n".join(filter(None, map(_section, _COMPARISONS)))


def _section(compared: _Comparison) -> str:
    rows, sources = [], []
    elsewhere = {name.format(stem) for name in _ELSEWHERE for stem in compared.tasks.values()}
    for label, (rolled, planned) in compared.models.items():
        for task, stem in compared.tasks.items():
            names = [name.format(stem) for name in (rolled, planned) if name]
            results = {name: result for name in names if (result := read(name)) is not None}
            if not results:
                continue
            cells = _rollout(results.get(rolled.format(stem))) + _planning(results.get(planned.format(stem)))
            rows.append([label, task, *cells])
            label = ""
            sources += [source(name, result) for name, result in results.items() if name not in elsewhere]
    if not sources:
        return ""
    head = ["model, and what it was trained on", "task", "Chamfer L1 (m)", "reward correlation", "planned", "steps"]
    told = "\n".join(sources)
    return f"## {compared.title}\n\n{paragraph(compared.about)}\n{compared.trained}\n{grid(head, rows)}\n{told}"


def _rollout(result: dict[str, Any] | None) -> list[str]:
    if result is None:
        return ["-", "-"]
    row = next(iter(result["rows"].values()))["all"]
    return [number(row["chamfer_l1"], 4), number(row["reward_correlation"], 3)]


def _planning(result: dict[str, Any] | None) -> list[str]:
    if result is None:
        return ["-", "-"]
    return [f"{result['successes']} of {result['episodes']}", number(result["mean_steps_of_successes"], 0)]
