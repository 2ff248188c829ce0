"""``pwm-gym data``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pwm_gym.commands.folders import data_folder
from pwm_gym.errors import PwmGymError

__all__ = ["Data"]


@dataclass(frozen=True)
class Export:
    """Write a data set in another library's format."""

    task: str = "PickCube"
    """Registered task whose folder of data is read where ``--data`` is not given."""
    data: Path | None = None
    """Folder of the data set. None takes ``data-sets/`` and the task's name."""
    to: Literal["minari", "lerobot"] = "minari"
    """Format to write; LeRobot's needs the extra "lerobot"."""
    id: str = ""
    """Minari's name of the new data set. Not given takes ``pwm/``, the task's name and ``/collected-v0``."""
    out: Path | None = None
    """New folder of a LeRobot data set. None takes ``data-sets/``, the task's name and "-lerobot"."""
    splits: tuple[str, ...] = ()
    """Splits to write: train, validation, test. None given takes all for Minari, and train for LeRobot, which trains on
    all that it finds."""
    kinds: tuple[str, ...] = ()
    """Kinds of episodes to write, such as expert; none given takes all."""

    def run(self) -> None:
        """Write it, and print where it is."""
        import pwm_gym  # noqa: F401  (registers the environments that the export names)
        from pwm_gym.data.dataset import read_header

        folder = data_folder(self.task, self.data)
        task = read_header(folder).task
        if self.to == "minari":
            self._to_minari(folder, self.id or f"pwm/{task}/collected-v0")
        else:
            self._to_lerobot(folder, data_folder(f"{task}-lerobot", self.out))

    def _to_minari(self, folder: Path, dataset_id: str) -> None:
        from pwm_gym.data.minari_format import export_minari

        if self.out is not None:
            raise PwmGymError(f"--out {self.out}; Minari stores its data sets itself (MINARI_DATASETS_PATH)")
        written = export_minari(folder, dataset_id, self.splits, self.kinds)
        print(f"Minari data set {dataset_id}: {written.total_episodes} episodes, {written.total_steps} steps")

    def _to_lerobot(self, folder: Path, out: Path) -> None:
        from pwm_gym.data.lerobot_format import export_lerobot

        if self.id:
            raise PwmGymError(f"--id {self.id}; a LeRobot data set has a folder: expected --out FOLDER")
        print(f"LeRobot data set: {export_lerobot(folder, out, self.splits or ('train',), self.kinds)}")


@dataclass(frozen=True)
class Import:
    """Write a Minari data set into a folder that ``pwm-gym train`` accepts.

    It was exported here or elsewhere, or holds demonstrations of Gymnasium-Robotics' Adroit environments, such as
    ``D4RL/door/human-v2``. Those are replayed in the task's own simulator.
    """

    id: Annotated[str, tyro.conf.Positional]
    """Minari's name of the data set."""
    out: Path
    """New folder of the data set."""
    task: str = ""
    """Task that the data must be of; any where it is not given."""
    download: bool = False
    """Fetch it from Minari's remote where it is not on this machine."""
    tolerance: float = 0.05
    """Of demonstrations: metres and radians by which a replay may stray from its recording, or else is left out."""
    split_seed: int = 0
    """Of demonstrations: seed of the draw that parts them into training, validation and test."""
    follow: bool = False
    """Of demonstrations: put positions back to the recorded ones after each step, where another version of MuJoCo
    recorded them: what strays is then a single step alone."""

    def run(self) -> None:
        """Write it, and print where it is."""
        from pwm_gym.data.minari_format import import_minari

        task = self.task or None
        replay = {name: getattr(self, name) for name in ("tolerance", "split_seed", "follow")}
        folder = import_minari(self.id, self.out, task, self.download, progress=True, **replay)
        print(f"data set: {folder}")
        self._tell_replay()

    def _tell_replay(self) -> None:
        """Print how many demonstrations were left out, and how many of the others succeed."""
        from pwm_gym.data.dataset import load_splits, read_header

        replay = read_header(self.out).settings.get("replay")
        if replay is None:
            return
        episodes = [episode for split in load_splits(self.out).values() for episode in split.episodes]
        successes = sum(bool(episode.success.any()) for episode in episodes)
        print(
            f"{len(episodes)} of {replay['recorded']} episodes, {successes} with success; "
            f"left out, because their replay strays by more than {replay['tolerance']} m or rad: {replay['left_out']}"
        )


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
