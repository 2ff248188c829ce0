"""Small synthetic scenes of every kind of robot and joint, and synthetic episodes of them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pwm_gym.data import Dataset, Episode
from pwm_gym.data.dataset import FORMAT, save_asset
from pwm_gym.data.episodes import FORMAT as EPISODES
from pwm_gym.data.episodes import write_shard
from pwm_gym.dynamics import build_model
from pwm_gym.robots import Arm, ArmKinematics, Channel, Control
from pwm_gym.robots.panda import PANDA
from pwm_gym.scene import FIXED, FREE, Joint, Layout, Mimic, RigidState, Support
from pwm_gym.scene.se3 import make_pose, matrix_from_pose7, pose7_from_matrix


@dataclass(frozen=True)
class Body:
    """A box-shaped entity of a synthetic scene."""

    half: tuple[float, float, float]
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where it rests, metres; of no account where its joint says it."""
    joint: Joint = FREE
    driven: bool = False


@dataclass(frozen=True)
class World:
    """A small scene of boxes, with its robot's control."""

    bodies: Mapping[str, Body]
    control: Control = field(default_factory=Control)
    points: int = 16

    @property
    def layout(self) -> Layout:
        return Layout.build(
            [(name, self.points) for name in self.bodies],
            [name for name, b in self.bodies.items() if b.driven],
            {name: b.joint for name, b in self.bodies.items()},
            [Support.ground()],
        )

    def plus(self, **bodies: Body) -> "World":
        """The same world with further bodies."""
        return replace(self, bodies={**self.bodies, **bodies})

    def only(self, *names: str) -> "World":
        """The same world with these bodies alone, in this order."""
        return replace(self, bodies={name: self.bodies[name] for name in names})

    def clouds(self, batch: int = 1, seed: int = 0) -> torch.Tensor:
        """Points (batch, N, 3) on the faces of the boxes, the same in each scene."""
        rng = np.random.default_rng(seed)
        every = []
        for body in self.bodies.values():
            points = rng.uniform(-1, 1, (self.points, 3))
            side = np.arange(self.points) % 6
            points[np.arange(self.points), side // 2] = np.where(side % 2, 1.0, -1.0)
            every.append(points * body.half)
        return torch.as_tensor(np.concatenate(every), dtype=torch.float32).expand(batch, -1, -1)

    def state(self, batch: int = 2, moving: bool = True, seed: int = 0, spread: float = 0.05) -> RigidState:
        """Scenes whose bodies are about where they belong, at rest or in motion; joints lie on their joints."""
        rng = np.random.default_rng(seed)

        def draw(*shape):
            return rng.uniform(-1, 1, (batch, *shape))

        steps = np.arange(3) * float(moving)
        placed: dict[str, torch.Tensor] = {}
        q: dict[str, np.ndarray] = {}
        arms = {arm.hand: arm for arm in self.control.arms if arm.chain}
        joints = np.zeros((batch, 2, 9), np.float32) if arms else None
        for name, body in self.bodies.items():
            if name in arms:
                arm = arms[name]
                speed = 0.01 * draw(arm.chain.joints) * moving
                rest = np.asarray(arm.chain.rest) + 0.1 * draw(arm.chain.joints)
                joints[:, :, arm.joints] = np.stack([rest, speed], 1)
                angles = rest[:, None] - steps[:, None] * speed[:, None]
                placed[name] = ArmKinematics(arm.chain)(torch.as_tensor(angles, dtype=torch.float32))
            elif body.joint.moves:
                joint = body.joint
                span = joint.upper - joint.lower
                now = joint.lower + span * (0.5 + 0.2 * draw(1)) - 0.02 * span * steps * draw(1)
                if joint.mimic is not None:
                    now = joint.mimic.multiplier * q[joint.mimic.entity] + joint.mimic.offset
                q[name] = now
                placed[name] = self._parent(joint, placed, batch) @ hung(joint, now)
            elif body.joint.parent is not None:
                placed[name] = self._parent(body.joint, placed, batch) @ matrix(body.joint.origin)
            else:
                still = 0.0 if body.joint.kind == "fixed" else 1.0
                place = np.abs(spread * draw(1, 3)) if body.at[2] < 0.05 else spread * draw(1, 3)  # above the ground
                way = np.asarray(body.at) + still * (place - 0.004 * steps[:, None] * draw(1, 3))
                turn = still * (0.2 * draw(1, 3) - 0.02 * steps[:, None] * draw(1, 3))
                turn, way = (np.array(np.broadcast_to(x, (batch, 3, 3))) for x in (turn, way))
                turned = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix()
                placed[name] = make_pose(
                    torch.as_tensor(turned.reshape(batch, 3, 3, 3), dtype=torch.float32),
                    torch.as_tensor(way, dtype=torch.float32),
                )
        frames = torch.stack([placed[name] for name in self.bodies], 2)
        known = None if joints is None else torch.as_tensor(joints)
        return RigidState(self.layout, self.clouds(batch), frames, known)

    @staticmethod
    def _parent(joint: Joint, placed: dict[str, torch.Tensor], batch: int) -> torch.Tensor:
        if joint.parent is None:
            return torch.eye(4).expand(batch, 3, 4, 4)
        return placed[joint.parent]

    def model(self, seed: int = 0, **settings):
        """A compact model with random weights in its last layers, too, so that all of it moves something."""
        torch.manual_seed(seed)
        small = {"points": 12, "point_width": 16, "width": 32, "blocks": 2, "arm_width": 16}
        model = build_model("compact", self.layout, self.control, {**small, **settings}).eval()
        with torch.no_grad():
            responses = [arm.net[-1] for arm, known in zip(model.robot.arms, model.robot.known, strict=True) if known]
            for head in (model.movers.head, model.robot.slide, *model.robot.heads, *responses):
                torch.nn.init.normal_(head.weight, std=0.2)
                torch.nn.init.normal_(head.bias, std=0.2)
            model.robot.response.hand_weight.normal_(std=0.01)
        return model

    def actions(self, batch: int = 2, seed: int = 0) -> torch.Tensor:
        """Random actions (batch, A) in [-1, 1]."""
        return torch.rand(batch, self.control.size, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def matrix(pose7) -> torch.Tensor:
    return matrix_from_pose7(torch.tensor(pose7, dtype=torch.float64)).float()


def hung(joint: Joint, q: np.ndarray) -> torch.Tensor:
    """Poses (..., 4, 4) in the parent's frame at positions (...): the plain formula, by SciPy."""
    q = np.asarray(q, float)
    axis = np.asarray(joint.axis)
    local = np.tile(np.eye(4), (*q.shape, 1, 1))
    if joint.kind == "revolute":
        turned = Rotation.from_rotvec((q[..., None] * axis).reshape(-1, 3)).as_matrix()
        local[..., :3, :3] = turned.reshape(*q.shape, 3, 3)
    else:
        local[..., :3, 3] = q[..., None] * axis
    origin = np.eye(4)
    origin[:3, :3] = Rotation.from_quat(joint.origin[3:], scalar_first=True).as_matrix()
    origin[:3, 3] = joint.origin[:3]
    return torch.as_tensor(origin @ local, dtype=torch.float32)


_CUBE = Body((0.02, 0.02, 0.02), (0.6, 0.0, 0.02))
_DOWN = (0.0, 1.0, 0.0, 0.0)
_PANDA = {
    "hand": Body((0.03, 0.1, 0.03), driven=True),
    "left_gripper": Body((0.01, 0.01, 0.03), joint=PANDA.joints["left_gripper"], driven=True),
    "right_gripper": Body((0.01, 0.01, 0.03), joint=PANDA.joints["right_gripper"], driven=True),
}
_SHELF = {  # a drawer with a handle in a cabinet, and a lidded box with a knob on its lid
    "cabinet": Body((0.15, 0.2, 0.1), (0.7, 0.4, 0.1), FIXED),
    "drawer": Body(
        (0.12, 0.15, 0.05),
        joint=Joint("prismatic", "cabinet", (-0.02, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5), (0.0, 0.0, -1.0), 0.0, 0.2),
    ),
    "handle": Body((0.01, 0.05, 0.01), joint=Joint("fixed", "drawer", (-0.13, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))),
}
_CHEST = {
    "box": Body((0.1, 0.1, 0.05), (0.5, -0.3, 0.05), FIXED),
    "lid": Body(
        (0.1, 0.1, 0.01),
        joint=Joint("revolute", "box", (0.0, 0.1, 0.06, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), -1.5, 0.1),
    ),
    "knob": Body((0.01, 0.01, 0.01), joint=Joint("fixed", "lid", (0.0, -0.09, 0.02, 1.0, 0.0, 0.0, 0.0))),
}


def _hand_of(side: str, y: float) -> dict[str, Body]:
    """A hand with two bending fingers, the second of which follows the first, and a tip that bends on the first."""
    first = Joint("revolute", f"{side}_hand", (0.0, 0.03, -0.05, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), -0.2, 1.2)
    tip = Joint("revolute", f"{side}_index", (0.0, 0.0, -0.04, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, 1.0)
    thumb = replace(
        first, origin=(0.0, -0.03, -0.05, 1.0, 0.0, 0.0, 0.0), lower=-1.2, upper=0.2,
        mimic=Mimic(f"{side}_index", -0.5, 0.05),
    )  # fmt: skip
    return {
        f"{side}_hand": Body((0.03, 0.05, 0.03), (0.5, y, 0.25), driven=True),
        f"{side}_index": Body((0.01, 0.01, 0.02), joint=first, driven=True),
        f"{side}_tip": Body((0.01, 0.01, 0.02), joint=tip, driven=True),
        f"{side}_thumb": Body((0.01, 0.01, 0.02), joint=thumb, driven=True),
        f"{side}_nail": Body(
            (0.005, 0.005, 0.005), joint=Joint("fixed", f"{side}_tip", (0.0, 0.01, 0.0, *_DOWN)), driven=True
        ),
    }


def _channels(side: str, start: int) -> tuple[Channel, ...]:
    return (
        Channel("translation", start, start + 3, 0.05, arm=side),
        Channel("rotation", start + 3, start + 6, 0.1, arm=side),
        Channel("finger", start + 6, start + 12, rest=None, arm=side),
    )


_TWO_ARMS = Control(
    (*_channels("left", 0), *_channels("right", 12)), (Arm("left", "left_hand"), Arm("right", "right_hand")), 0.1
)
_FOUR = Control(
    (Channel("translation", 0, 3, 0.1, arm="arm"), Channel("gripper", 3, 4, rest=1.0, arm="arm")), PANDA.control.arms
)
_FREE_HAND = replace(PANDA.control, arms=(Arm("arm", "hand"),))
_FINGERS = Control((Channel("finger", 0, 2, rest=None),))
WORLDS = {
    "cube": World({**_PANDA, "cube": _CUBE}, PANDA.control),
    "drawer": World({**_PANDA, **_SHELF, "cube": _CUBE}, PANDA.control),
    "lid": World({**_PANDA, **_CHEST}, PANDA.control),
    "four": World({**_PANDA, **_CHEST, "cube": _CUBE}, _FOUR),
    "unknown arm": World({"hand": Body((0.03, 0.1, 0.03), (0.5, 0.0, 0.2), driven=True), "cube": _CUBE}, _FREE_HAND),
    "two arms": World({**_hand_of("left", 0.2), **_hand_of("right", -0.2), "cube": _CUBE, **_SHELF}, _TWO_ARMS),
    "pot": World(  # a loose pot with a handle, a sliding cover on it, and a stopper that bends on the cover
        {
            **_PANDA,
            "pot": Body((0.05, 0.05, 0.04), (0.6, 0.0, 0.04)),
            "grip": Body((0.03, 0.01, 0.01), joint=Joint("fixed", "pot", (0.08, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))),
            "cover": Body(
                (0.05, 0.05, 0.005),
                joint=Joint("prismatic", "pot", (0.0, 0.0, 0.045, *_DOWN), (1.0, 0.0, 0.0), -0.02, 0.05),
            ),
            "stopper": Body(
                (0.01, 0.01, 0.01),
                joint=Joint("revolute", "cover", (0.0, 0.0, -0.01, *_DOWN), (0.0, 0.0, 1.0), -1.0, 1.0),
            ),
            "cube": replace(_CUBE, at=(0.4, 0.2, 0.02)),
        },
        PANDA.control,
    ),
    "bolted hand": World(
        {
            "palm": Body((0.05, 0.05, 0.02), (0.5, 0.0, 0.2), FIXED, driven=True),
            "finger": Body(
                (0.01, 0.01, 0.03),
                joint=Joint("revolute", "palm", (0.0, 0.05, 0.0, 1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0, 1.5),
                driven=True,
            ),
            "cube": _CUBE,
        },
        _FINGERS,
    ),
    "no arm": World({"cube": _CUBE, "ball": replace(_CUBE, at=(0.4, 0.1, 0.05)), **_CHEST}),
    "one thing": World({"cube": _CUBE}),
}


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
