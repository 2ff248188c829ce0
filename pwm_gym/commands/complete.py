"""``pwm-gym complete``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from pwm_gym.commands.numbers import check_least
from pwm_gym.completion import CompletionTrainConfig, ObjectSet

if TYPE_CHECKING:
    from pwm_gym.completion import Completer, ViewConfig, Views

__all__ = ["Complete"]

_CLEAN = "clean"
_DRAWN, _SHOWN = 12, 2048  # objects of a gallery, and points of each
_VALIDATION = 40  # generated shapes, none of which is trained on
_CELLS = ("chamfer", "partial", "hull", "floor", "centroid_percent", "better_than_hull")


@dataclass(frozen=True)
class Train:
    """Train a network on generated shapes, and on ``--meshes`` if they are given.

    ``torchrun --nproc-per-node 2 -m pwm_gym complete train`` shares the training; a killed run goes on where it was.
    """

    size: str = "compact"
    """Network: compact or paper."""
    out: Path = Path("runs/completion")
    """Folder of the training."""
    objects: tyro.conf.OmitArgPrefixes[ObjectSet] = field(default_factory=ObjectSet)
    training: tyro.conf.OmitArgPrefixes[CompletionTrainConfig] = field(default_factory=CompletionTrainConfig)

    def run(self) -> None:
        """Train it, and print where it is."""
        from pwm_gym.completion import fit_completion
        from pwm_gym.learning import is_main_process
        from pwm_gym.process import prepare_process

        main = is_main_process()
        prepare_process(self.training.threads)
        validate = _Validation(replace(self.objects, shapes=_VALIDATION, meshes=None))
        checkpoint = fit_completion(self.objects, self.size, self.training, self.out, validate)
        if main:
            print(f"checkpoint: {checkpoint}")


@dataclass(frozen=True)
class Evaluate:
    """Measure a network on new views of meshes, seen and held out, clean and with sensor and occlusion."""

    meshes: Path
    """Folder, file or archive of meshes."""
    held_out: tuple[str, ...] = ()
    """Those of them that were not trained on."""
    checkpoint: str = "default"
    """A folder, or "default" for the shipped one."""
    views: int = 20
    """Views of each object."""
    view_seed: int = 0
    """Of the views."""
    pictures: Path | None = None
    """Folder for galleries (PNG) of objects and of the worst of their views."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Print the table, draw the galleries and write the results."""
        from pwm_gym.completion import Views
        from pwm_gym.evaluation import write_results
        from pwm_gym.evaluation.completion import evaluate_completion
        from pwm_gym.perception import clean

        check_least(self, views=1, view_seed=0, threads=1)
        objects = ObjectSet(shapes=0, meshes=self.meshes, held_out=self.held_out)
        splits = {"seen": objects.read(), "unseen": objects.read(seen=False)}
        completer, description = _load(self.checkpoint, self.threads)
        rows: dict[str, Any] = {}
        for split, meshes in splits.items():
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
                    for chosen, file in ((first, split), (worst, f"{split}_worst")):
                        _gallery(completer, views, names, chosen, self.pictures / f"{file}.png", self.view_seed)
        _print(rows)
        if self.json is not None:
            write_results(self.json, {"checkpoint": description["training"], "views": self.views, "rows": rows})


@dataclass(frozen=True)
class View:
    """Complete one random view of a mesh."""

    mesh: Annotated[Path, tyro.conf.Positional]
    """Its file."""
    checkpoint: str = "default"
    """A folder, or "default" for the shipped one."""
    view_seed: int = 0
    """Of the view."""
    pictures: Path | None = None
    """Folder for a picture (PNG) of what is seen, completed and true."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Print how near the completed cloud is to the mesh, and draw it."""
        from pwm_gym.completion import Views, load_meshes, normalise
        from pwm_gym.evaluation.completion import evaluate_completion

        check_least(self, view_seed=0, threads=1)
        meshes = {name: normalise(mesh) for name, mesh in load_meshes(self.mesh).items()}
        completer, _ = _load(self.checkpoint, self.threads)
        names, views = list(meshes), Views(list(meshes.values()), _conditions()[_CLEAN])
        _print({self.mesh.stem: evaluate_completion(completer, views, names, 1, seed=self.view_seed)})
        if self.pictures is not None:
            chosen = [(name, 0) for name in names]
            _gallery(completer, views, names, chosen, self.pictures / f"{self.mesh.stem}.png", self.view_seed)


@dataclass(frozen=True)
class Complete:
    """Complete partial clouds: ``pwm-gym complete train``, ``complete evaluate`` and ``complete view``."""

    action: Annotated[
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[View, tyro.conf.subcommand("view")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        """Train, measure or complete."""
        self.action.run()


def _load(checkpoint: str, threads: int) -> tuple[Completer, dict[str, Any]]:
    """A network that completes, and what its checkpoint tells of it."""
    from pwm_gym.completion import LearnedCompleter, load_completion
    from pwm_gym.process import prepare_process

    prepare_process(threads)
    net, description = load_completion(checkpoint)
    return LearnedCompleter(net), description


def _gallery(
    completer: Completer, views: Views, names: list[str], chosen: list[tuple[str, int]], path: Path, seed: int
) -> None:
    """Chosen views (object, number), each as it is seen, completed and true."""
    import numpy as np

    from pwm_gym.evaluation.completion import score_completion, view_of
    from pwm_gym.scene import spread
    from pwm_gym.viewer.gallery import GalleryRow, draw_gallery

    rows = []
    for name, number in chosen:
        view, surface = view_of(views, names.index(name), number, seed)
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
