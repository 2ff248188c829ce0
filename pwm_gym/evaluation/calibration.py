"""Whether a model knows how far off it is: its expected errors against the real ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from pwm_gym.evaluation.metrics import spearman
from pwm_gym.evaluation.rollouts import Rollouts
from pwm_gym.scene import RigidState

__all__ = ["calibration"]

_POINTS = 32  # of each entity: enough for a mean distance
_BINS = 10


def calibration(rollouts: Rollouts, chosen: np.ndarray) -> dict[str, Any] | None:
    """Expected against real error over every step of the chosen episodes (M,); None where the model does not tell.

    Returns:
        ``rank_correlation``: Spearman's, of each entity and of the mean over entities ("mean"); None where one
            never moves.
        ``bins``: ten equally filled bins of the expected mean error, each with the expected and the real one, metres.
    """
    predicted = rollouts.states
    if not isinstance(predicted, RigidState) or predicted.error is None:
        return None
    layout = predicted.layout.truncate(_POINTS)
    truth = rollouts.true_states().coarsen(layout)
    gaps = (predicted.coarsen(layout).points() - truth.points()).norm(dim=-1)  # (M, H, n)
    real = torch.stack([gaps[..., e.slice].mean(-1) for e in layout], -1)
    kept = rollouts.mask & torch.as_tensor(chosen)[:, None]
    told, found = (x[kept].double().numpy() for x in (predicted.error, real))
    told, found = (np.c_[x, x.mean(1)] for x in (told, found))
    names = [*layout.names, "mean"]
    ranks = {name: spearman(told[:, i], found[:, i]) for i, name in enumerate(names)}
    order = np.argsort(told[:, -1], kind="stable")
    bins = [
        {
            "expected": float(told[part, -1].mean()),
            "real_mean": float(found[part, -1].mean()),
            "real_median": float(np.median(found[part, -1])),
        }
        for part in np.array_split(order, _BINS)
        if len(part)
    ]
    return {"steps": len(told), "rank_correlation": ranks, "bins": bins}
