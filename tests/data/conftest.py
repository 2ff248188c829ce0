import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pwm_gym.data import Dataset, Episode
from pwm_gym.data.dataset import FORMAT, save_asset
from pwm_gym.data.episodes import FORMAT as EPISODES
from pwm_gym.data.episodes import write_shard
from pwm_gym.scene.se3 import pose7_from_matrix


@dataclass(frozen=True)
class Recorder:
    """Synthetic episodes of a world, and the files that collection would write."""

    def episode(self, world, seed=0, steps=6, goal=3, assets=(), kind=0) -> Episode:
        """Bodies that drift about; every frame is another, so that it can be recognised."""
        start = world.state(1, moving=False, seed=seed)
        poses = pose7_from_matrix(start.frames[0, 0])[None].repeat(steps + 1, 1, 1).numpy()
        poses[..., 0] += 0.004 * np.arange(steps + 1)[:, None]
        rng = np.random.default_rng(seed)
        return Episode(
            poses=poses,
            joints=rng.normal(size=(steps + 1, 2, 9)).astype(np.float32),
            actions=rng.uniform(-1, 1, (steps, world.control.size)).astype(np.float32),
            rewards=rng.uniform(size=steps).astype(np.float32),
            success=np.arange(steps) == steps - 1,
            grasped=np.zeros(steps, bool),
            goal=rng.normal(size=goal).astype(np.float32),
            kind=kind,
            seed=seed,
            assets=assets,
        )

    def dataset(self, world, task="Test", episodes=3, goal=3, steps=6) -> Dataset:
        """Episodes whose assets are the layout's own."""
        clouds = world.clouds()[0].numpy()
        assets = {e.name: clouds[e.slice] for e in world.layout}
        every = tuple(self.episode(world, seed, steps + seed, goal) for seed in range(episodes))
        return Dataset(task, world.layout, assets, every)

    def several(self, world, task="Test") -> Dataset:
        """Six episodes; the cube of each is one of three assets, larger from one to the next."""
        plain = self.dataset(world, task)
        cubes = {f"cube {k}": plain.assets["cube"] * (1 + k) for k in range(3)}
        rest = {name: points for name, points in plain.assets.items() if name != "cube"}
        names = [tuple(f"cube {k % 3}" if n == "cube" else n for n in world.layout.names) for k in range(6)]
        every = tuple(self.episode(world, k, 4 + k, assets=names[k]) for k in range(6))
        return replace(plain, assets={**rest, **cubes}, episodes=every)

    def write(self, dataset: Dataset, folder: Path, split="train", **header) -> Path:
        """The data set in files, as collection writes it."""
        described = {"format": FORMAT, "schema": 2, "settings": {"task": dataset.task}}
        described |= {"layout": dataset.layout.to_json(), **header}
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "dataset.json").write_text(json.dumps(described))
        for name, points in dataset.assets.items():
            save_asset(folder, name, points)
        shard = {"format": EPISODES, "schema": 2, "task": dataset.task}
        write_shard(folder / f"{split}-demonstration-00000.npz", dataset.episodes, shard)
        return folder


@pytest.fixture(scope="session")
def recorder() -> Recorder:
    return Recorder()
