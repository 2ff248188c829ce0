"""``pwm-gym complete``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from pwm_gym.completion import CompletionTrainConfig, ObjectSet

if TYPE_CHECKING:
    from pwm_gym.completion import Completer, ViewConfig, Views

__all__ = ["Complete"]

_CLEAN = "clean"
_DRAWN, _SHOWN = 12, 2048  # objects of a gallery, and points of each
_VALIDATION = 40  # generated shapes, none of which is trained on
_CELLS = ("chamfer", "partial", "hull", "floor", "centroid_percent", "better_than_hull")


@dataclass(frozen=True)
class Complete:
    """Train and measure the completion of partial clouds, or complete one view of a mesh.

    ``torchrun --nproc-per-node 2 -m pwm_gym complete --train`` shares the training.
    """

    train: bool = False
    """Train a network on generated shapes, and on ``--meshes`` if they are given."""
    evaluate: bool = False
    """Measure it on new views of the meshes, seen and held out, clean and with sensor and occlusion."""
    mesh: Path | None = None
    """A mesh to complete from one random view."""
    checkpoint: str = "default"
    """A folder, or "default" for the shipped one; after ``--train`` the trained one."""
    size: str = "compact"
    """Network to train: compact or paper."""
    out: Path = Path("runs/completion")
    """Folder of the training."""
    views: int = 20
    """Views of each object in the evaluation."""
    view_seed: int = 0
    """Of the views that are evaluated, or of the one of ``--mesh``."""
    pictures: Path | None = None
    """Folder for galleries (PNG) of evaluated objects and of the worst of their views, or of ``--mesh``."""
    json: Path | None = None
    """Where to write the results of the evaluation."""
    objects: tyro.conf.OmitArgPrefixes[ObjectSet] = field(default_factory=ObjectSet)
    training: tyro.conf.OmitArgPrefixes[CompletionTrainConfig] = field(default_factory=CompletionTrainConfig)

    def run(self) -> None:
        """Do what is asked for, one after the other."""
        from pwm_gym.completion import LearnedCompleter, fit_completion, load_completion
        from pwm_gym.errors import PwmGymError
        from pwm_gym.learning import is_main_process
        from pwm_gym.process import prepare_process

        if not (self.train or self.evaluate or self.mesh):
            raise PwmGymError("nothing to do; expected --train, --evaluate or --mesh FILE")
        if self.evaluate and self.objects.meshes is None:
            raise PwmGymError("--evaluate has no objects to complete; expected --meshes FOLDER")
        main = is_main_process()
        prepare_process(self.training.threads)
        checkpoint = self.checkpoint
        if self.train:
            validate = _Validation(replace(self.objects, shapes=_VALIDATION, meshes=None))
            checkpoint = str(fit_completion(self.objects, self.size, self.training, self.out, validate))
            if not main:
                return
            print(f"checkpoint: {checkpoint}")
        if self.evaluate or self.mesh:
            net, description = load_completion(checkpoint)
            completer = LearnedCompleter(net)
            if self.evaluate:
                self._evaluate(completer, description)
            if self.mesh:
                self._complete(completer, self.mesh)

    def _evaluate(self, completer: Completer, description: dict[str, Any]) -> None:
        from pwm_gym.completion import Views
        from pwm_gym.evaluation import write_results
        from pwm_gym.evaluation.completion import evaluate_completion
        from pwm_gym.perception import clean

        rows: dict[str, Any] = {}
        for split, seen in (("seen", True), ("unseen", False)):
            meshes = self.objects.read(seen)
            if not meshes:
                continue  # all objects are of the other split
            names = list(meshes)
            for name, config in _conditions().items():
                views = Views(list(meshes.values()), config, cleaner=clean)
                row = evaluate_completion(completer, views, names, self.views, seed=self.view_seed)
                rows[f"{split}, {name}"] = row
                if self.pictures is not None and name == _CLEAN:
                    first = [(n, 0) for n in names[:: -(-len(names) // _DRAWN)]]
                    worst = [(w["name"], w["view"]) for w in row["worst"]]
                    self._gallery(completer, views, names, first, self.pictures / f"{split}.png")
                    self._gallery(completer, views, names, worst, self.pictures / f"{split}_worst.png")
        _print(rows)
        if self.json is not None:
            write_results(self.json, {"checkpoint": description["training"], "views": self.views, "rows": rows})

    def _complete(self, completer: Completer, path: Path) -> None:
        from pwm_gym.completion import Views, load_meshes, normalise
        from pwm_gym.evaluation.completion import evaluate_completion

        meshes = {name: normalise(mesh) for name, mesh in load_meshes(path).items()}
        names, views = list(meshes), Views(list(meshes.values()), _conditions()[_CLEAN])
        _print({path.stem: evaluate_completion(completer, views, names, 1, seed=self.view_seed)})
        if self.pictures is not None:
            chosen = [(name, 0) for name in names]
            self._gallery(completer, views, names, chosen, self.pictures / f"{path.stem}.png")

    def _gallery(
        self, completer: Completer, views: Views, names: list[str], chosen: list[tuple[str, int]], path: Path
    ) -> None:
        """Chosen views (object, number), each as it is seen, completed and true."""
        import numpy as np

        from pwm_gym.evaluation.completion import score_completion, view_of
        from pwm_gym.scene import spread
        from pwm_gym.viewer.gallery import GalleryRow, draw_gallery

        rows = []
        for name, number in chosen:
            view, surface = view_of(views, names.index(name), number, self.view_seed)
            truth, done = surface[:_SHOWN], completer(view.partial, np.zeros(3), _SHOWN).points
            label = f"{name}: {1e3 * score_completion(done, truth).chamfer:.0f}"
            rows.append(GalleryRow(label, (spread(view.partial, _SHOWN), done, truth)))
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_gallery(rows, "seen, completed and true; Chamfer distance x 1000").save(path)
        print(path)


class _Validation:
    """Chamfer distances of generated shapes that are not trained on."""

    def __init__(self, objects: ObjectSet) -> None:
        from pwm_gym.completion import Views, random_shapes

        self.views = Views(random_shapes(objects.shapes, first=0), _conditions()[_CLEAN])

    def __call__(self, net: Any) -> dict[str, float]:
        from pwm_gym.completion import LearnedCompleter
        from pwm_gym.evaluation.completion import evaluate_completion

        names = list(map(str, range(len(self.views.meshes))))
        found = evaluate_completion(LearnedCompleter(net), self.views, names, 2, progress=False)
        return {k: found[k] for k in ("chamfer", "partial", "floor", "centroid_percent")}


def _conditions() -> dict[str, ViewConfig]:
    from pwm_gym.completion import ViewConfig

    clean = ViewConfig().clean()
    return {_CLEAN: clean, "sensor and 30 % hidden": replace(clean, sensed=1.0, occluded=1.0, hidden=(0.3, 0.3))}


def _print(rows: dict[str, Any]) -> None:
    print(f"  {'':32s}" + "".join(f"{cell.replace('_', ' '):>18s}" for cell in _CELLS))
    for name, row in rows.items():
        print(f"  {name:32s}" + "".join(f"{row[cell]:18.2f}" for cell in _CELLS))
