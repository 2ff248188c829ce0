"""Infos of a batch in Gymnasium's form: arrays (num_envs,), each with its mask ``_key``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from torch import Tensor

from pwm_gym.envs.common import Judgement
from pwm_gym.envs.texts import text_array

__all__ = ["vector_infos"]


def vector_infos(
    judgement: Judgement, reasons: Sequence[str], stage_names: Sequence[str], errors: Mapping[str, Tensor] | None = None
) -> dict[str, Any]:
    """What a step is told to be.

    Args:
        judgement: of the states (B,).
        reasons: why episodes are truncated, B texts, empty where they are not.
        stage_names: of a sequence of stages.
        errors: entity -> expected error (B,) in metres; None where the model tells none.
    """
    known: dict[str, Any] = {
        "success": judgement.success,
        "grasped": judgement.grasped,
        "cost_terms": _masked(judgement.terms, len(reasons)),
        "reason": text_array(reasons),
    }
    if judgement.stage is not None:
        known["stage"] = text_array(stage_names)[judgement.stage.cpu().numpy()]
    if errors is not None:
        known["expected_error"] = _masked(errors, len(reasons))
    return _masked(known, len(reasons))


def _masked(values: Mapping[str, Any], count: int) -> dict[str, Any]:
    """Arrays of ``values``, each with a mask that says that all ``count`` environments have it."""
    arrays = {key: value.cpu().numpy().copy() if isinstance(value, Tensor) else value for key, value in values.items()}
    return {**arrays, **{f"_{key}": np.ones(count, bool) for key in values}}
