"""One small, whole file of every kind that the package reads, and how it is read."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import damage
import numpy as np
import torch
import trimesh
from PIL import Image
from torch import nn

from pwm_gym.agents.config import AgentConfig
from pwm_gym.agents.policy import algorithm_class, load_agent, policy_name, policy_settings, save_agent
from pwm_gym.agents.training import train as train_policy
from pwm_gym.assets.folder import AssetFolder
from pwm_gym.cameras import DepthCamera
from pwm_gym.completion import CompletionConfig, CompletionNet, load_completion, load_meshes, save_completion
from pwm_gym.data import Episode, load_split
from pwm_gym.data.dataset import FORMAT, save_asset
from pwm_gym.data.episodes import FORMAT as EPISODES
from pwm_gym.data.episodes import read_shard, write_shard
from pwm_gym.dynamics import SceneBank, build_model, load_checkpoint, save_checkpoint
from pwm_gym.envs.common import OBSERVATIONS, action_space
from pwm_gym.evaluation.planning import claim_folder
from pwm_gym.experiments.pieces import Piece
from pwm_gym.learning import LoopConfig, run_training
from pwm_gym.learning.weights import save_weights
from pwm_gym.perception import Frame, load_frames
from pwm_gym.planning import Run
from pwm_gym.policies import PolicyConfig, load_policy
from pwm_gym.policies.network import Policy
from pwm_gym.robots.cloud import RobotCloud
from pwm_gym.scene import SCHEMA, Scene
from pwm_gym.tasks import get_task

__all__ = ["LAYOUT", "Sample", "make_samples"]

TASK = get_task("PickCube")
LAYOUT = TASK.layout.truncate(6)
_SMALL = {"points": 6, "searched": 6, "point_width": 8, "width": 16, "blocks": 1, "arm_width": 8}
_COMPLETION = CompletionConfig(
    points=(32, 16), channels=(4, 8), neighbours=4, features=8, blocks=1, heads=2, width=8, seed_channels=8, kept=8,
    factors=(2,), hidden=4, sources=2,
)  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """A whole file."""

    path: Path
    """What is damaged."""
    read: Callable[[], Any]
    """Reads it, with all that belongs to it."""
    damage: damage.Damage


def make_samples(folder: Path) -> dict[str, Sample]:
    """Kind -> its file, written below ``folder``."""
    torch.manual_seed(0)
    makers = (_arrays, _data_set, _pictures, _checkpoints, _policies, _trainings, _meshes, _robots, _notes)
    found: dict[str, Sample] = {}
    for make in makers:
        found |= make(folder / make.__name__.strip("_"))
    return found


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _poses(*shape: int) -> np.ndarray:
    rng, entities = _rng(), len(LAYOUT)
    quaternion = rng.normal(size=(*shape, entities, 4))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.concatenate([rng.normal(size=(*shape, entities, 3)), quaternion], -1)


def make_scene() -> Scene:
    """A scene of PickCube with few points."""
    clouds = _rng().normal(size=(LAYOUT.points, 3)).astype(np.float32)
    return Scene(TASK.name, LAYOUT, clouds, _poses(3), np.zeros(3, np.float32), np.zeros((2, 9), np.float32))


def _episode() -> Episode:
    return Episode(
        poses=_poses(4).astype(np.float32),
        joints=np.zeros((4, 2, 9), np.float32),
        actions=np.zeros((3, 7), np.float32),
        rewards=np.zeros(3, np.float32),
        success=np.zeros(3, bool),
        grasped=np.zeros(3, bool),
        goal=np.zeros(3, np.float32),
        kind=0,
        seed=1,
        assets=LAYOUT.names,
    )


def _run() -> Run:
    return Run(
        start=make_scene(),
        seed=0,
        success=True,
        actions=np.zeros((2, 7), np.float32),
        rewards=np.zeros(2),
        plan_seconds=np.zeros(2),
        poses=_poses(3),
        predicted=_poses(2),
        predicted_rewards=np.zeros(2),
        terms={"reach": np.zeros(2)},
        predicted_terms={"reach": np.ones(2)},
        settings={"cost": "pick_cube"},
    )


def _camera() -> DepthCamera:
    return DepthCamera(np.array([[5.0, 0, 4], [0, 5, 3], [0, 0, 1]]), np.eye(4), 8, 6)


def _arrays(folder: Path) -> dict[str, Sample]:
    """Scenes, episodes, runs and frames."""
    folder.mkdir()
    scene, shard, run, frame = (folder / f"{name}.npz" for name in ("scene", "shard", "run", "frame"))
    make_scene().save(scene)
    write_shard(shard, [_episode(), _episode()], {"format": EPISODES, "schema": SCHEMA, "task": TASK.name})
    _run().save(run)
    depth, masks = np.full((6, 8), 0.7, np.float32), {"cube": np.zeros((6, 8), bool)}
    Frame(np.zeros((6, 8, 3), np.uint8), depth, _camera(), joints=np.zeros(9), masks=masks).save(frame)
    reads: dict[Path, Callable[[], Any]] = {
        scene: lambda: Scene.load(scene).validate(TASK.name, LAYOUT, TASK.goal_size),
        shard: lambda: read_shard(shard, TASK.name),
        run: lambda: Run.load(run),
        frame: lambda: Frame.load(frame),
    }
    return {path.stem: Sample(path, read, damage.damage_npz) for path, read in reads.items()}


def _data_set(folder: Path) -> dict[str, Sample]:
    header = {"format": FORMAT, "schema": SCHEMA, "settings": {"task": TASK.name}, "layout": LAYOUT.to_json()}
    folder.mkdir()
    (folder / "dataset.json").write_text(json.dumps(header))
    scene = make_scene()
    for entity in LAYOUT:
        save_asset(folder, entity.name, scene.clouds[entity.slice])
    shard = folder / "train-demonstration-00000.npz"
    write_shard(shard, [_episode()], {"format": EPISODES, "schema": SCHEMA, "task": TASK.name})

    def read() -> None:
        dataset = load_split(folder, "train", TASK.name)
        dataset.scene(dataset.episodes[0], 1)

    return {
        "data set": Sample(folder / "dataset.json", read, damage.damage_json),
        "asset of a data set": Sample(folder / "asset-cube.npz", read, damage.damage_npz),
        "shard of a data set": Sample(shard, read, damage.damage_npz),
    }


def _pictures(folder: Path) -> dict[str, Sample]:
    """A folder of recorded images, with depth as pictures and as arrays."""
    camera, found = _camera(), {}
    told = {"intrinsics": camera.intrinsics.tolist(), "pose": camera.pose.tolist(), "width": 8, "height": 6}
    for kind in ("png", "npy"):
        own = folder / kind
        own.mkdir(parents=True)
        (own / "camera.json").write_text(json.dumps(told))
        np.save(own / "joints.npy", np.zeros((1, 9)))
        Image.fromarray(np.full((6, 8, 3), 3, np.uint8)).save(own / "colour-0.png")
        Image.fromarray(np.full((6, 8), 255, np.uint8)).save(own / "mask-cube-0.png")
        if kind == "png":
            Image.fromarray(np.full((6, 8), 500, np.uint16)).save(own / "depth-0.png")
        else:
            np.save(own / "depth-0.npy", np.full((6, 8), 0.5))
        found[kind] = (own, partial(load_frames, own))
    (png, read_png), (npy, read_npy) = found["png"], found["npy"]
    return {
        "camera": Sample(png / "camera.json", read_png, damage.damage_json),
        "depth picture": Sample(png / "depth-0.png", read_png, damage.damage_png),
        "colour picture": Sample(png / "colour-0.png", read_png, damage.damage_png),
        "mask": Sample(png / "mask-cube-0.png", read_png, damage.damage_png),
        "depth array": Sample(npy / "depth-0.npy", read_npy, damage.damage_array_file),
        "recorded joints": Sample(npy / "joints.npy", read_npy, damage.damage_array_file),
    }


def _checkpoints(folder: Path) -> dict[str, Sample]:
    """World models and the completion network."""
    scene, found = make_scene(), {}
    bank = SceneBank(
        TASK.name,
        LAYOUT,
        scene.clouds[None],
        scene.poses.astype(np.float32),
        np.zeros((3, 3), np.float32),
        np.zeros(3, int),
    )
    for kind, settings in {"compact": _SMALL, "linear": {}}.items():
        own = folder / kind
        model = build_model(kind, LAYOUT, TASK.control, settings)
        save_checkpoint(own, model, kind, [bank], {"data": {}}, {})
        found |= _weights(f"checkpoint, {kind}", own, partial(load_checkpoint, own))
    own = folder / "compact"
    found["scene bank"] = Sample(own / "scenes-PickCube.npz", partial(load_checkpoint, own), damage.damage_npz)
    own = folder / "completion"
    save_completion(own, CompletionNet(_COMPLETION), {}, {})
    return found | _weights("completion", own, partial(load_completion, own))


def _weights(kind: str, folder: Path, read: Callable[[], Any]) -> dict[str, Sample]:
    """A network's two files."""
    return {
        f"{kind}: description": Sample(folder / "config.json", read, damage.damage_json),
        f"{kind}: weights": Sample(folder / "model.safetensors", read, damage.damage_safetensors),
    }


def _policies(folder: Path) -> dict[str, Sample]:
    """A policy learned by PPO, and one cloned."""
    config = AgentConfig(width=8)
    space = OBSERVATIONS["poses"].space(TASK.layout, TASK.goal_size)
    kind: Any = algorithm_class("ppo").policy_aliases[policy_name(config)]  # type: ignore[attr-defined]
    acts = kind(space, action_space(TASK.action_size), lambda _: 0.0, **policy_settings(TASK, config))
    learned, cloned = folder / "learned", folder / "cloned"
    save_agent(learned, acts, TASK, config, {"seconds": 0.0})
    small = PolicyConfig(8, 1)
    described = {"task": TASK.name, "config": {"width": 8, "depth": 1}, "demonstrations": 1}
    policy = Policy(TASK.layout, TASK.action_size, TASK.goal_size, small)
    save_weights(cloned, policy, {"format": "pwm_gym.policy", "schema": SCHEMA, **described})
    return {
        **_weights("agent", learned, partial(load_agent, learned, TASK.name)),
        **_weights("cloned policy", cloned, partial(load_policy, cloned)),
    }


class _Loss(nn.Module):
    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, batch: torch.Tensor) -> torch.Tensor:
        return self.model(batch).square().mean()


def _trainings(folder: Path) -> dict[str, Sample]:
    """States that killed trainings resume from."""
    config = LoopConfig(phases=((1, 1, 2),), optimizer="adamw", threads=1)

    def train() -> None:
        model = nn.Linear(2, 2)
        run_training(
            model,
            _Loss(model),
            lambda generator, step, world: torch.rand(2, 2, generator=generator),
            config,
            folder,
            lambda model: {},
            lambda model, metrics: None,
            progress=False,
        )

    train()
    agent = folder / "agent"
    small = AgentConfig(steps=8, num_envs=2, rollout=4, width=8, episode_steps=4, threads=1)
    train_agent = partial(train_policy, TASK.name, agent, small, progress=False)
    train_agent()
    return {
        "training state": Sample(folder / "training-state.pt", train, damage.damage_bytes),
        "training state of an agent": Sample(agent / "training-state.zip", train_agent, damage.damage_bytes),
        "progress of an agent": Sample(agent / "progress.json", train_agent, damage.damage_json),
    }


def _meshes(folder: Path) -> dict[str, Sample]:
    """Meshes of every format, and the folder of PickYCB's objects."""
    folder.mkdir()
    box, found = trimesh.creation.box((0.1, 0.2, 0.3)), {}
    for ending, how in {"obj": "text", "ply": "bytes", "stl": "bytes", "glb": "bytes"}.items():
        path = folder / f"box.{ending}"
        box.export(path)
        break_it = damage.damage_text if how == "text" else damage.damage_bytes
        found[f"mesh, {ending}"] = Sample(path, partial(load_meshes, path), break_it)
    path = folder / "text.ply"
    path.write_bytes(box.export(file_type="ply", encoding="ascii"))
    found["mesh, ply as text"] = Sample(path, partial(load_meshes, path), damage.damage_text)
    path = folder / "meshes.npz"
    np.savez(path, **{"box/v": box.vertices, "box/f": box.faces})
    found["meshes, npz"] = Sample(path, partial(load_meshes, path), damage.damage_npz)
    assets = AssetFolder(folder / "assets")
    assets.write("shape", box, [box])
    assets.write_info(["shape"])
    found["list of objects"] = Sample(assets.info_path, partial(assets.write_info, ["shape"]), damage.damage_json)
    pieces = assets.model("shape") / "collision.ply"
    found["convex pieces"] = Sample(pieces, partial(assets.pieces, "shape"), damage.damage_text)
    return found


_URDF = """<robot name="arm">
  <link name="base"/>
  <link name="hand">
    <collision><origin xyz="0 0 0.1" rpy="0 0 0.5"/><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
    <collision><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision>
  </link>
  <link name="finger"><collision><geometry><mesh filename="box.obj" scale="1 1 1"/></geometry></collision></link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="hand"/><origin xyz="0 0 0.5" rpy="0 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="hand"/><child link="finger"/><mimic joint="turn" multiplier="0.5" offset="0.1"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def _robots(folder: Path) -> dict[str, Sample]:
    """A robot's description."""
    folder.mkdir()
    path = folder / "arm.urdf"
    path.write_text(_URDF)
    trimesh.creation.box((0.1, 0.2, 0.3)).export(folder / "box.obj")

    def read() -> None:
        RobotCloud.from_urdf(path, ["hand", "finger"], points=8).points(torch.zeros(1, 1))

    return {"robot description": Sample(path, read, damage.damage_text)}


def _notes(folder: Path) -> dict[str, Sample]:
    """Results of pieces, and what tells how a folder's runs were planned."""
    piece = Piece("row", "kind", "recipe", folder, lambda _: {})
    piece.folder.mkdir(parents=True)
    piece.result.write_text(json.dumps({"commit": "abc", "rates": [0.5, 0.25], "name": "row"}))
    recipe = {"task": TASK.name, "planner": "mppi", "limits": [0.1, None]}
    claim_folder(folder, recipe)
    return {
        "result of a piece": Sample(piece.result, piece.read, damage.damage_json),
        "recipe of runs": Sample(folder / "planned-by.json", partial(claim_folder, folder, recipe), damage.damage_json),
    }
