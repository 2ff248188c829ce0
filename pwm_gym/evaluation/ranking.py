"""Is a world model a trustworthy place to compare policies? How success in it agrees with success in the simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation.metrics import pearson, spearman
from pwm_gym.evaluation.planning import wilson

__all__ = ["max_rank_violation", "measure_text", "ranking_table"]

_DRAWS = 500  # of the bootstrap


def max_rank_violation(*, simulator: np.ndarray, model: np.ndarray) -> float:
    """Mean maximum rank violation (MMRV) of P policies: 0 where the model orders them as the simulator does.

    The mean over policies i of the greatest |R_i - R_j| over those j that the model orders the other way, R being the
    simulator's success: what is lost, at worst, by trusting the model's order.

    Args:
        simulator: success rates R (P,).
        model: success rates S (P,).
    """
    real, told = np.asarray(simulator, np.float64), np.asarray(model, np.float64)
    gaps = np.abs(real[:, None] - real[None])
    swapped = (told[:, None] > told[None]) != (real[:, None] > real[None])
    return float((gaps * swapped).max(1).mean())


def ranking_table(names: Sequence[str], model: np.ndarray, simulator: np.ndarray) -> dict[str, Any]:
    """How well success in the model tells success in the simulator.

    Args:
        names: of the P policies.
        model: success (P, N) bool in the model, from N scenes.
        simulator: success (P, N) bool in the simulator, from the same scenes.

    Returns:
        Pearson's r, Spearman's, and MMRV, each with a 95 % interval over draws of scenes; the share of episodes that
        end alike; and each policy's rates.

    Raises:
        PwmGymError: fewer than two policies, no scene, or matrices that do not fit.
    """
    told, real = np.asarray(model, bool), np.asarray(simulator, bool)
    if len(names) < 2 or told.shape != real.shape or told.shape[:1] != (len(names),) or told.ndim != 2:
        raise PwmGymError(
            f"{len(names)} policies with success of shapes {told.shape} and {real.shape}; expected two policies or "
            "more, and (policies, scenes) twice"
        )
    if not told.shape[1]:
        raise PwmGymError("no scene is left to rank by; expected at least one that is not solved at reset")
    draws = np.random.default_rng(0).integers(0, told.shape[1], (_DRAWS, told.shape[1]))
    drawn = [each[:, draws].mean(-1).T for each in (told, real)]  # rates (D, P) twice
    measures = {"pearson": pearson, "spearman": spearman, "mmrv": _violation}
    return {
        "policies": len(names),
        "scenes": told.shape[1],
        **{name: _with_interval(measure, told.mean(1), real.mean(1), drawn) for name, measure in measures.items()},
        "agreement": float((told == real).mean()),
        "between_20_and_80": int(((real.mean(1) >= 0.2) & (real.mean(1) <= 0.8)).sum()),
        "rows": [_row(name, told[i], real[i]) for i, name in enumerate(names)],
    }


def _violation(model: np.ndarray, simulator: np.ndarray) -> float:
    return max_rank_violation(simulator=simulator, model=model)


def _with_interval(
    measure: Callable[[np.ndarray, np.ndarray], float | None],
    model: np.ndarray,
    simulator: np.ndarray,
    drawn: Sequence[np.ndarray],
) -> dict[str, Any]:
    """A measure of success rates (P,), and its 95 % interval over rates (D, P) of draws of scenes."""
    known = [value for told, real in zip(*drawn, strict=True) if (value := measure(told, real)) is not None]
    bounds = np.quantile(known, [0.025, 0.975]).tolist() if known else None
    return {"value": measure(model, simulator), "interval": bounds}


def _row(name: str, model: np.ndarray, simulator: np.ndarray) -> dict[str, Any]:
    """A policy's rates with their intervals, and how its episodes pair."""
    return {
        "name": name,
        "model": float(model.mean()),
        "model_interval": wilson(int(model.sum()), len(model)),
        "simulator": float(simulator.mean()),
        "simulator_interval": wilson(int(simulator.sum()), len(simulator)),
        "both": int((model & simulator).sum()),
        "model_alone": int((model & ~simulator).sum()),
        "simulator_alone": int((~model & simulator).sum()),
        "neither": int((~model & ~simulator).sum()),
    }


def measure_text(measure: Mapping[str, Any]) -> str:
    """A measure of a table with its interval, in words."""
    if measure["value"] is None:
        return "-"
    low, high = measure["interval"]
    return f"{measure['value']:.3f} ({low:.3f} to {high:.3f})"
