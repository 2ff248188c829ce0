"""Objects that a checkpoint never saw, on the table beside the task's own."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import torch

from pwm_gym.dynamics.checkpoint import Checkpoint
from pwm_gym.dynamics.model import WorldModel, rollout
from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation.planning import wilson
from pwm_gym.planning import Agent
from pwm_gym.scene import Scene, batch_state, sample_surface
from pwm_gym.scene.layout import Entity
from pwm_gym.sim import SimOutcome
from pwm_gym.sim.props import Prop, get_prop
from pwm_gym.tasks import Task

__all__ = [
    "DISTRACTORS",
    "SceneWorld",
    "add_distractors",
    "distractor_influence",
    "plan_among_distractors",
    "run_distractor_table",
]

_POINTS = 300  # of each distractor
_NEAR = 0.08  # metres between centres
_GAP = 0.005  # metres between bounding circles at least
_AREA = (-0.15, 0.15)  # metres from the object's centre, in x and y
_TRIES = 1000


DISTRACTORS: tuple[Prop, ...] = tuple(
    get_prop(f"distractor_{name}") for name in ("block", "can", "tile", "puck", "cube")
)
"""Five shapes of the size of what a gripper holds."""


class SceneWorld(Protocol):
    """A simulator that holds whatever bodies a scene has."""

    def restore(self, scene: Scene) -> None:
        """Start from a scene with its extra bodies, at rest."""

    def step(self, action: np.ndarray) -> SimOutcome:
        """Apply an action (A,) for one control step."""

    def poses(self) -> np.ndarray:
        """Poses (E, 7) of all entities of the scene, extra ones included."""

    def joints(self) -> np.ndarray:
        """Joint positions and velocities (2, J)."""


def run_distractor_table(
    checkpoint: Checkpoint,
    task: Task,
    episodes: int = 50,
    horizon: int = 30,
    plan: bool = True,
    world: SceneWorld | None = None,
) -> dict[str, Any]:
    """A checkpoint among five distractors, two of them within 8 cm of the task's first object.

    Args:
        checkpoint: its model and its scenes.
        task: registered task.
        episodes: scenes.
        horizon: steps of the rollouts by which the influence on predictions is measured.
        plan: whether to plan among them, too.
        world: simulator that holds further bodies, to plan in; None makes the task's own.

    Returns:
        "influence", as of :func:`distractor_influence` under uniformly random actions; "planning", as of
        :func:`plan_among_distractors`, or None.

    Raises:
        PwmGymError: the task has no object.
    """
    if not task.objects:
        raise PwmGymError(f"{task.name} has no object for distractors to stand about")
    bank = checkpoint.bank(task.name)
    plain = [bank.scene(k % len(bank)) for k in range(episodes)]
    cluttered = [add_distractors(scene, task.objects[0], k) for k, scene in enumerate(plain)]
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (episodes, horizon, task.action_size))
    planning = _plan(checkpoint, task, cluttered, world) if plan else None
    influence = distractor_influence(checkpoint.model, plain, cluttered, actions)
    return {"episodes": episodes, "horizon": horizon, "influence": influence, "planning": planning}


def _plan(checkpoint: Checkpoint, task: Task, scenes: Sequence[Scene], world: SceneWorld | None) -> dict[str, Any]:
    agent = Agent(checkpoint.model, task.name)
    if world is not None:
        return plan_among_distractors(agent, scenes, world, task.max_episode_steps)
    with closing(task.make_simulator()) as simulator:
        return plan_among_distractors(agent, scenes, simulator, task.max_episode_steps)


def add_distractors(scene: Scene, around: str, seed: int, count: int = 5, near: int = 2, table: float = 0.0) -> Scene:
    """The same scene with further objects at rest on the table.

    Args:
        scene: at rest.
        around: entity that they stand around.
        seed: of their places.
        count: how many of :data:`DISTRACTORS`.
        near: how many of them stand within 8 cm of that entity, centre to centre; the others do anywhere within 15 cm.
        table: height of the table, metres.

    Raises:
        PwmGymError: more than there are, or no room for them.
    """
    if not 0 <= near <= count <= len(DISTRACTORS):
        raise PwmGymError(f"count={count}, near={near}; expected 0 <= near <= count <= {len(DISTRACTORS)}")
    rng = np.random.default_rng([seed, 5])
    taken = _circles(scene)
    middle = scene.poses[0, scene.layout.index(around), :2]
    entities, clouds, poses = [], [scene.clouds], [scene.poses]
    for number, thing in enumerate(DISTRACTORS[:count]):
        place = _place(rng, middle, taken, thing.radius, _NEAR if number < near else np.inf)
        taken.append((place, thing.radius))
        turn = rng.uniform(0.0, 2.0 * np.pi)
        pose = np.array([*place, table + thing.half_height, np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)])
        poses.append(np.repeat(pose[None, None], 3, 0))
        clouds.append(sample_surface(thing.mesh(), _POINTS, number).astype(np.float32))
        entities.append(Entity(thing.name, 0, _POINTS))
    names = scene.assets or scene.layout.names
    return replace(
        scene,
        layout=scene.layout.plus(entities),
        clouds=np.concatenate(clouds),
        poses=np.concatenate(poses, 1),
        assets=(*names, *(e.name for e in entities)),
    )


def _circles(scene: Scene) -> list[tuple[np.ndarray, float]]:
    """Bounding circles, seen from above, of all entities that the robot does not drive."""
    points = batch_state([scene]).points()[0].numpy()
    found = []
    for entity in scene.layout:
        if not entity.driven:
            flat = points[entity.slice, :2]
            middle = 0.5 * (flat.min(0) + flat.max(0))
            found.append((middle, float(np.linalg.norm(flat - middle, axis=1).max())))
    return found


def _place(
    rng: np.random.Generator, middle: np.ndarray, taken: list[tuple[np.ndarray, float]], radius: float, within: float
) -> np.ndarray:
    """A free place (2,) for a circle."""
    for _ in range(_TRIES):
        offset = rng.uniform(*_AREA, 2)
        free = all(np.linalg.norm(middle + offset - other) > radius + wide + _GAP for other, wide in taken)
        if free and np.linalg.norm(offset) < within:
            place: np.ndarray = middle + offset
            return place
    raise PwmGymError(f"no room for a distractor of radius {radius} m after {_TRIES} tries")


@torch.no_grad()
def distractor_influence(
    model: WorldModel, plain: Sequence[Scene], cluttered: Sequence[Scene], actions: np.ndarray
) -> dict[str, Any]:
    """How much a model's prediction of the task's own entities changes when further objects stand there.

    Args:
        model: world model that takes any scene.
        plain: scenes (M,).
        cluttered: the same scenes with further entities behind their own.
        actions: (M, H, A).

    Returns:
        "own_mm": entity -> how far its predictions differ at the last step, mean; "distractors_mm": how far the further
        objects are predicted to move, mean and largest.
    """
    command = torch.as_tensor(actions, dtype=torch.float32)
    ends = [rollout(model, batch_state(list(scenes)), command)[:, -1].poses() for scenes in (plain, cluttered)]
    own = len(plain[0].layout)
    gaps = 1e3 * (ends[0] - ends[1][:, :own])[..., :3, 3].norm(dim=-1).mean(0)
    moved = 1e3 * (ends[1] - batch_state(list(cluttered)).poses())[:, own:, :3, 3].norm(dim=-1)
    names = plain[0].layout.names
    return {
        "own_mm": dict(zip(names, map(float, gaps), strict=True)),
        "distractors_mm": {"mean": float(moved.mean()), "largest": float(moved.max())},
    }


def plan_among_distractors(
    agent: Agent, scenes: Sequence[Scene], world: SceneWorld, max_steps: int = 100
) -> dict[str, Any]:
    """Closed-loop success from cluttered scenes, and how far the distractors were pushed.

    Args:
        agent: plans; its model takes any scene.
        scenes: with their distractors behind the task's own entities.
        world: simulator that holds them.
        max_steps: actions of an episode at most.
    """
    own = len(agent.task.layout)
    wins, steps, pushed = [], [], []
    for seed, scene in enumerate(scenes):
        agent.reset(seed)
        world.restore(scene)
        history = [scene.poses[0]] * 3
        seen, success, step = scene, False, 0
        while not success and step < max_steps:
            action = agent.act(seen)
            success, step = world.step(action).success, step + 1
            history = [world.poses(), *history[:2]]
            seen = replace(scene, poses=np.stack(history), joints=world.joints(), last_action=action)
        wins.append(success)
        steps.append(step)
        pushed.append(float(np.linalg.norm((history[0] - scene.poses[0])[own:, :3], axis=1).max(initial=0.0)))
    won = [s for s, w in zip(steps, wins, strict=True) if w]
    return {
        "episodes": len(wins),
        "successes": sum(wins),
        "interval": wilson(sum(wins), len(wins)),
        "mean_steps_of_successes": float(np.mean(won)) if won else None,
        "distractors_pushed_mm": {"mean": 1e3 * float(np.mean(pushed)), "largest": 1e3 * float(np.max(pushed))},
    }
