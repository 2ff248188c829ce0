"""``pwm-gym data``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pwm_gym.commands.folders import data_folder

__all__ = ["Data"]


@dataclass(frozen=True)
class Export:
    """Write a data set in another library's format."""

    task: str = "PickCube"
    """Registered task whose folder of data is read where ``--data`` is not given."""
    data: Path | None = None
    """Folder of the data set. None takes ``data-sets/`` and the task's name."""
    to: Literal["minari"] = "minari"
    """Format to write."""
    id: str = ""
    """Minari's name of the new data set. Not given takes ``pwm/``, the task's name and ``/collected-v0``."""
    splits: tuple[str, ...] = ()
    """Splits to write: train, validation, test; none given takes all that there are."""

    def run(self) -> None:
        """Write it, and print where it is."""
        import pwm_gym  # noqa: F401  (registers the environments that the export names)
        from pwm_gym.data.dataset import read_header
        from pwm_gym.data.minari_format import export_minari

        folder = data_folder(self.task, self.data)
        dataset_id = self.id or f"pwm/{read_header(folder).task}/collected-v0"
        written = export_minari(folder, dataset_id, self.splits)
        print(f"Minari data set {dataset_id}: {written.total_episodes} episodes, {written.total_steps} steps")


@dataclass(frozen=True)
class Import:
    """Write a Minari data set that was exported here or elsewhere into a folder that ``pwm-gym train`` accepts."""

    id: Annotated[str, tyro.conf.Positional]
    """Minari's name of the data set."""
    out: Path
    """New folder of the data set."""
    task: str = ""
    """Task that the data must be of; any where it is not given."""
    download: bool = False
    """Fetch it from Minari's remote where it is not on this machine."""

    def run(self) -> None:
        """Write it, and print where it is."""
        from pwm_gym.data.minari_format import import_minari

        print(f"data set: {import_minari(self.id, self.out, self.task or None, self.download, progress=True)}")


@dataclass(frozen=True)
class Data:
    """Exchange data sets with other libraries: ``pwm-gym data export``, ``pwm-gym data import``."""

    action: Annotated[
        Annotated[Export, tyro.conf.subcommand("export")] | Annotated[Import, tyro.conf.subcommand("import")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        """Export or import."""
        self.action.run()
