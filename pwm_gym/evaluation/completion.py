"""How well objects are completed: new views of seen and of unseen objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from tqdm import tqdm

from pwm_gym.completion import Completer, HullCompleter, ObjectView, Views
from pwm_gym.evaluation.metrics import nearest_distances
from pwm_gym.scene import spread

__all__ = ["CompletionScore", "evaluate_completion", "score_completion", "view_of"]

_WITHIN = 0.02  # of the F-score, in units of the object's size
_WORST = 8  # views that are told of


@dataclass(frozen=True)
class CompletionScore:
    """One completed cloud against the true surface, in units of the object's longest side."""

    chamfer: float
    """Symmetric Chamfer distance: half of both directions' sum, Euclidean."""
    accuracy: float
    """Mean distance of the completed points from the true ones."""
    completeness: float
    """Mean distance of the true points from the completed ones."""
    f_score: float
    """Harmonic mean of the shares of points that lie within 2 % of the other cloud."""
    centroid: float
    """Distance between the clouds' centroids."""


def score_completion(points: np.ndarray, truth: np.ndarray) -> CompletionScore:
    """Score points (n, 3) against points (m, 3) of the true surface."""
    there, back = nearest_distances(points, truth, order=2)
    precision, recall = float((there < _WITHIN).mean()), float((back < _WITHIN).mean())
    f_score = 2 * precision * recall / max(precision + recall, 1e-9)
    centroid = float(np.linalg.norm(points.mean(0) - truth.mean(0)))
    accuracy, completeness = float(there.mean()), float(back.mean())
    return CompletionScore(0.5 * (accuracy + completeness), accuracy, completeness, f_score, centroid)


def evaluate_completion(
    completer: Completer,
    views: Views,
    names: list[str],
    each: int = 20,
    points: int = 2048,
    seed: int = 0,
    progress: bool = True,
) -> dict[str, Any]:
    """Mean scores of new views of some objects, beside the partial cloud's, its hull's and a perfect completion's.

    Args:
        completer: completes.
        views: of the objects.
        names: of the objects, in the order of the views' meshes.
        each: views an object.
        points: of each completed cloud, and of the truth.
        seed: of the views.
        progress: whether to show a bar.

    Returns:
        "chamfer", "accuracy", "completeness" (times 1000), "f_score", "centroid_percent" of the completion; "partial",
        "hull" and "floor" (Chamfer distances times 1000); "better_than_hull" (share of the views); "error_rank"
        (correlation of expected and real errors); "objects" (Chamfer times 1000 by name); "worst" (the views with the
        largest Chamfer distances: "name", "view", "chamfer").
    """
    hull, rows = HullCompleter(), []
    for index, name in enumerate(tqdm(names, disable=not progress, desc="complete", leave=False)):
        for k in range(each):
            view, surface = view_of(views, index, k, seed)
            truth, fresh = surface[:points], surface[points : 2 * points]
            done = completer(view.partial, np.zeros(3), points)
            rows.append(
                {
                    "name": name,
                    "view": k,
                    "error": done.error,
                    "score": score_completion(done.points, truth),
                    "partial": score_completion(spread(view.partial, points), truth).chamfer,
                    "hull": score_completion(hull(view.partial, np.zeros(3), points).points, truth).chamfer,
                    "floor": score_completion(fresh, truth).chamfer,
                }
            )
    return _summary(rows)


def view_of(views: Views, index: int, number: int, seed: int = 0) -> tuple[ObjectView, np.ndarray]:
    """One of the views that are evaluated, and points (n, 3) of the true surface in its frame, in random order.

    Args:
        views: of the objects.
        index: of the object.
        number: of its view.
        seed: of all views.
    """
    rng = np.random.default_rng([seed, index, number])
    view = views.view(index, rng)
    return view, rng.permutation(views.surface(index)) @ view.pose[:3, :3].T + view.pose[:3, 3]


def _summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    def mean(values: list[float]) -> float:
        return float(np.mean(values))

    scores = [r["score"] for r in rows]
    objects = sorted({r["name"] for r in rows})
    worst = sorted(rows, key=lambda r: -r["score"].chamfer)[:_WORST]
    return {
        "views": len(rows),
        "chamfer": 1e3 * mean([s.chamfer for s in scores]),
        "accuracy": 1e3 * mean([s.accuracy for s in scores]),
        "completeness": 1e3 * mean([s.completeness for s in scores]),
        "f_score": mean([s.f_score for s in scores]),
        "centroid_percent": 100 * mean([s.centroid for s in scores]),
        **{name: 1e3 * mean([r[name] for r in rows]) for name in ("partial", "hull", "floor")},
        "better_than_hull": mean([float(r["score"].chamfer < r["hull"]) for r in rows]),
        "error_rank": float(spearmanr([r["error"] for r in rows], [s.chamfer for s in scores]).statistic),
        "worst": [{"name": r["name"], "view": r["view"], "chamfer": 1e3 * r["score"].chamfer} for r in worst],
        "objects": {n: 1e3 * mean([r["score"].chamfer for r in rows if r["name"] == n]) for n in objects},
    }
