"""``pwm-gym assets``: the objects of PickSingleYCB."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from pwm_gym.assets.pieces import PieceConfig

__all__ = ["Assets", "Liftable", "Shapes", "Ycb"]


@dataclass(frozen=True)
class Ycb:
    """Build ManiSkill's folder of YCB objects from meshes. A run that was killed goes on where it was."""

    source: Annotated[Path, tyro.conf.arg(name="from")]
    """An .npz of <object>/v and <object>/f, or a folder of .glb, .obj, .ply and .stl files; metres."""
    out: Path | None = None
    """Folder to build in; ManiSkill's own (MS_ASSET_DIR, or ~/.maniskill) if not given."""
    objects: tuple[str, ...] = ()
    """Objects to build; all if not given."""
    workers: int = 1
    """Processes."""
    pieces: PieceConfig = field(default_factory=PieceConfig)

    def run(self) -> None:
        """Build, with a progress bar."""
        from pwm_gym.assets import asset_root, build_ycb

        folder = build_ycb(self.source, self.out or asset_root(), self.objects, self.workers, self.pieces)
        print(f"{len(folder.names())} objects: {folder.base}")


@dataclass(frozen=True)
class Shapes:
    """Build the generated shapes, with which PickSingleYCB runs without a download."""

    out: Path | None = None
    """Folder to build in; the user's cache if not given."""

    def run(self) -> None:
        """Build."""
        from pwm_gym.assets import generated_assets

        folder = generated_assets(self.out)
        print(f"{len(folder.names())} shapes: {folder.base}")


@dataclass(frozen=True)
class Liftable:
    """Let the scripted expert pick each object some times. A run that was killed goes on where it was."""

    root: Path | None = None
    """Folder of the objects; ManiSkill's own (MS_ASSET_DIR, or ~/.maniskill) if not given."""
    out: Path = Path("ycb_liftable.json")
    """Where to write the record."""
    objects: tuple[str, ...] = ()
    """Objects to pick; all if not given."""
    tries: int = 5
    """Episodes of each."""
    max_steps: int = 150
    """Longest episode."""

    def run(self) -> None:
        """Pick, with a progress bar."""
        from pwm_gym.assets import require_ycb
        from pwm_gym.assets.liftable import measure_liftable
        from pwm_gym.process import prepare_process

        prepare_process(threads=1)
        folder = require_ycb(self.root, self.objects)
        record = measure_liftable(folder, self.out, self.objects, self.tries, self.max_steps)
        print(", ".join(f"{key.replace('_', ' ')} {value}" for key, value in record["summary"].items()))


@dataclass(frozen=True)
class Assets:
    """Make and measure assets: YCB's meshes, generated shapes, and which objects can be lifted."""

    action: Annotated[
        Annotated[Ycb, tyro.conf.subcommand("ycb")]
        | Annotated[Shapes, tyro.conf.subcommand("shapes")]
        | Annotated[Liftable, tyro.conf.subcommand("liftable")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        """Do what is asked for."""
        self.action.run()
