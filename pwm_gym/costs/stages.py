"""Costs of long tasks: a sequence of stages, each with terms of its own and a rule that tells when it is over.

Each element of a batch is in a stage of its own, and moves on inside a rollout where the rule says so: a plan may cross
from one stage into the next. Sequences concatenate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pwm_gym.costs.registry import COSTS, Cost, Function, Info, Points, check_name
from pwm_gym.errors import PwmGymError, UnknownEntityError

__all__ = ["FINISHED", "STAGES_LEFT", "UNDONE", "Stage", "StagedCost", "register_stages"]

FINISHED = "finished"
"""What the stage is called when all are over."""
STAGES_LEFT = "stages_left"
"""Term that counts the stages which are not over."""
UNDONE = "undone"
"""Term that counts the stages which are over and whose lasting rule is broken."""


@dataclass(frozen=True)
class Stage:
    """One stage of a long task."""

    name: str
    terms: Mapping[str, tuple[float, Function]]
    """Term -> weight and function ``(points, info) -> (B,)``: what planners descend in this stage."""
    done: Function
    """Rule ``(points, info) -> bool (B,)``: the stage is over."""
    lasting: Function | None = None
    """Rule ``(points, info) -> bool (B,)`` that has to hold from then on, such as that what was brought stays where it
    is; where a scene breaks it, the stage begins anew."""

    def plus(self, terms: Mapping[str, tuple[float, Function]]) -> Stage:
        """The same stage with further terms, or with others of the same names."""
        return replace(self, terms={**self.terms, **terms})

    def renamed(self, name: str) -> Stage:
        """The same stage under another name, where a sequence has it twice."""
        return replace(self, name=name)


@dataclass(frozen=True)
class StagedCost(Cost):
    """The present stage's terms, terms that always count, and a price for each stage that is not over.

    It reads ``info["stage"]`` (B,): 0 in the first stage, the number of stages when all are over. Where no stage is
    told, each scene counts as the first of its episode.

    Raises:
        PwmGymError: no stage, two stages of one name, one without a rule for its end, or a price that is not positive.
    """

    stages: tuple[Stage, ...]
    price: float = 20.0
    """Of a stage that is not over: more than its terms can differ, so that going on to the next one always pays."""

    def __post_init__(self) -> None:
        """Check the sequence."""
        names = [stage.name for stage in self.stages]
        if not names:
            raise PwmGymError(f"cost {self.name!r} has no stages; expected at least one")
        if taken := [name for i, name in enumerate(names) if name in (*names[:i], FINISHED)]:
            raise PwmGymError(f"cost {self.name!r} has a second stage {taken[0]!r}; expected names that differ")
        if endless := [stage.name for stage in self.stages if not callable(stage.done)]:
            raise PwmGymError(
                f"cost {self.name!r}: stage {endless[0]!r} has no end (done={None}); expected a rule for each"
            )
        if not self.price > 0:
            raise PwmGymError(f"cost {self.name!r}: price={self.price}; expected more than 0")

    @property
    def stage_names(self) -> tuple[str, ...]:
        """Name of each stage, and of what follows the last one."""
        return (*(stage.name for stage in self.stages), FINISHED)

    def begin(self, count: int, device: torch.device | str = "cpu") -> Tensor:
        """The first stage (B,) of ``count`` episodes."""
        return torch.zeros(count, dtype=torch.long, device=device)

    def advance(self, stage: Tensor, points: Points, info: Info) -> Tensor:
        """Stage (B,) after scenes (B,) that were reached in ``stage`` (B,); several may end in one scene.

        A stage whose lasting rule is broken begins anew.
        """
        found = self.along(stage, points, info, 1).squeeze(1)
        for k, broken in reversed(self._broken(found, points, info).items()):
            found = torch.where(broken, k, found)
        return found

    def along(self, stage: Tensor, points: Points, info: Info, steps: int) -> Tensor:
        """Stages (B, T) along sequences of T scenes, none of which begins anew.

        Args:
            stage: before the first scene (B,).
            points: of the scenes (B T, n, 3), each sequence's one after the other.
            info: what a cost reads of them.
            steps: T.

        Raises:
            PwmGymError: stages that the sequence has not, or a rule that reads what the scenes lack.
        """
        last = len(self.stages)
        if not bool(((stage >= 0) & (stage <= last)).all()):
            raise PwmGymError(f"cost {self.name!r}: stages {stage.tolist()}; expected values from 0 to {last}")
        entered = torch.zeros_like(stage)  # step (B,) in which stage k begins; T where it does not
        times = torch.arange(steps, device=stage.device)
        found = stage.unsqueeze(1).repeat(1, steps)
        for k in range(int(stage.min()), last):
            if bool((entered == steps).all()):
                break
            begun = stage <= k
            over = self._over(k, points, info).view(-1, steps) & (times >= entered.unsqueeze(1))
            first = torch.where(over.any(1), over.int().argmax(1), steps)
            entered = torch.where(begun, first, 0)
            found = found + (begun.unsqueeze(1) & (times >= entered.unsqueeze(1)))
        return found

    def evaluate(self, points: Points, info: Info) -> dict[str, Tensor]:
        """Weighted terms by name, each (B,): those of a stage are zero in all others. Errors as of other costs."""
        batch, device = len(info["action"]), info["action"].device
        stage = info.get("stage")
        if stage is None:
            stage = self.advance(self.begin(batch, device), points, info)
        values = super().evaluate(points, info)
        values[STAGES_LEFT] = self.price * (len(self.stages) - stage).to(torch.float32)
        nothing = values[STAGES_LEFT].new_zeros(batch)
        if any(part.lasting for part in self.stages):
            values[UNDONE] = self.price * sum(self._broken(stage, points, info).values(), nothing)
        for k, part in enumerate(self.stages):
            here = stage == k
            told = self._weighted(part.terms, points, info) if here.any() else dict.fromkeys(part.terms, nothing)
            values |= {f"{part.name}: {name}": torch.where(here, value, nothing) for name, value in told.items()}
        return values

    def _broken(self, stage: Tensor, points: Points, info: Info) -> dict[int, Tensor]:
        """Of stages with a lasting rule: whether (B,) scenes that are past them break it."""
        return {
            k: (stage > k) & ~self._told(k, part.lasting, points, info)
            for k, part in enumerate(self.stages)
            if part.lasting is not None and bool((stage > k).any())
        }

    def _over(self, k: int, points: Points, info: Info) -> Tensor:
        """Whether (B T,) the stage ``k`` is over in each scene."""
        return self._told(k, self.stages[k].done, points, info)

    def _told(self, k: int, rule: Function, points: Points, info: Info) -> Tensor:
        """What (B,) a rule of stage ``k`` says."""
        try:
            return rule(points, info)
        except UnknownEntityError as error:
            raise PwmGymError(f"cost {self.name!r}, stage {self.stages[k].name!r}: {error}") from error


def register_stages(
    name: str, stages: Sequence[Stage], terms: Mapping[str, tuple[float, Function]] | None = None
) -> StagedCost:
    """Register a cost that is a sequence of stages.

    Args:
        name: what planners and ``gym.make(..., cost=name)`` take.
        stages: one after the other.
        terms: term -> weight and function, of what counts in every stage.

    Raises:
        ValueError: the name is taken.
        PwmGymError: the name is none, or a sequence that cannot be (:class:`StagedCost`).
    """
    check_name("cost", name, COSTS)
    cost = StagedCost(name, dict(terms or {}), tuple(stages))
    COSTS[name] = cost
    return cost
