"""Speed: environments against the simulator, rollouts, plans, planners of other libraries, perception."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

from pwm_gym.cameras import RayCaster
from pwm_gym.cameras.viewpoints import CAMERA
from pwm_gym.costs import get_cost, get_grasp
from pwm_gym.dynamics import WorldModel, rollout
from pwm_gym.perception.build import build_observer
from pwm_gym.planning import MPPIConfig, RolloutObjective, build_planner
from pwm_gym.planning.adapters import FlatModel
from pwm_gym.scene import Scene, batch_state, sample_clouds
from pwm_gym.seeds import seed_range
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

__all__ = [
    "adapter_overhead",
    "compare_planners",
    "model_rates",
    "perception_times",
    "plan_times",
    "rollout_floor",
    "rollout_times",
    "simulator_rate",
]

_EPISODE = 50  # steps
_LEAST_NOISE = 1e-3  # pytorch_mppi's may not be 0


def simulator_rate(task: Task, seconds: float) -> float:
    """Steps a second of the simulator's own environment under random actions (Gymnasium's benchmark).

    Of a simulator without one, of the simulator itself.
    """
    twin: Any = gym.make(f"pwm/{task.name}Sim-v0").unwrapped
    environment = getattr(twin.simulator, "env", None)
    if environment is None:
        rate = _own_rate(twin.simulator, twin.action_space, seconds)
    else:
        rate = benchmark_step(environment, target_duration=seconds, seed=0)  # type: ignore[arg-type]
    twin.close()
    return rate


def _own_rate(simulator: Simulator, actions: gym.Space[Any], seconds: float) -> float:
    """Steps a second of a simulator under random actions, episodes included."""
    actions.seed(0)
    start, steps = time.perf_counter(), 0
    while time.perf_counter() - start < seconds:
        if steps % _EPISODE == 0:
            simulator.reset(steps)
        simulator.step(actions.sample())
        steps += 1
    return steps / (time.perf_counter() - start)


def model_rates(task: Task, counts: Sequence[int], seconds: float) -> dict[int, float]:
    """Environment steps a second of the native batch, by number of environments (Gymnasium's benchmark)."""
    rates = {}
    for count in counts:
        envs = gym.make_vec(f"pwm/{task.name}-v0", num_envs=count)
        rates[count] = benchmark_vector_step(envs, target_duration=seconds, seed=0)  # type: ignore[arg-type]
        envs.close()
    return rates


def adapter_overhead(
    task: Task, adapt: Callable[[gym.vector.VectorEnv[Any, Any, Any]], Any], count: int, steps: int = 100
) -> dict[str, float]:
    """What an adapter of the native batch costs: steps of one without it and of one within it, in turn.

    Both show poses, are given the same actions, and start episodes anew at the same steps.

    Args:
        task: the task.
        adapt: puts a batch into the adapter, whose ``step`` takes actions (count, A).
        count: environments of each batch.
        steps: of each.

    Returns:
        Median seconds of a step, "native_seconds" and "adapter_seconds", and "overhead", the median share by which the
        second is longer.
    """
    made = [
        gym.make_vec(
            f"pwm/{task.name}-v0",
            num_envs=count,
            autoreset_mode="SameStep",
            max_episode_steps=_EPISODE,
            observation="poses",
        )
        for _ in range(2)
    ]
    native, adapted = made[0], adapt(made[1])
    native.reset(seed=0)
    adapted.seed(0)
    adapted.reset()
    rng, times = np.random.default_rng(0), np.empty((steps + _EPISODE // 5, 2))
    for row in times:
        actions = rng.uniform(-1.0, 1.0, (count, task.action_size)).astype(np.float32)
        for place, step in enumerate((native.step, adapted.step)):
            begun = time.perf_counter()
            step(actions)
            row[place] = time.perf_counter() - begun
    counted = times[-steps:]
    middle = np.median(counted, 0)
    return {
        "native_seconds": float(middle[0]),
        "adapter_seconds": float(middle[1]),
        "overhead": float(np.median(counted[:, 1] / counted[:, 0])) - 1.0,
    }


def rollout_times(
    model: WorldModel, scene: Scene, sizes: Sequence[tuple[int, int]], repeats: int = 9
) -> dict[str, float]:
    """Median seconds of one batched rollout, by "samples x horizon"."""
    times = {}
    for samples, horizon in sizes:
        state = batch_state([scene] * samples)
        actions = _actions(samples, horizon, model.action_size)
        with torch.inference_mode():
            times[f"{samples} x {horizon}"] = _median(partial(rollout, model, state, actions), repeats)
    return times


def plan_times(
    model: WorldModel, task: Task, scene: Scene, sizes: Sequence[tuple[int, int, int]], repeats: int = 9
) -> dict[str, float]:
    """Median seconds of the cost of action sequences, by "samples x horizon x points" (of the scene in all)."""
    times = {}
    for samples, horizon, points in sizes:
        coarse = scene.coarsen(task.layout.resize(points))
        objective = RolloutObjective(model, get_cost(task.plan_cost), get_grasp(task.grasp))
        objective.begin(batch_state([coarse]), torch.as_tensor(scene.goal)[None])
        actions = _actions(samples, horizon, model.action_size)[None]
        times[f"{samples} x {horizon} x {points}"] = _median(partial(objective, actions), repeats)
    return times


def rollout_floor(model: WorldModel, scene: Scene, samples: int, horizon: int) -> dict[str, float]:
    """What a rollout must take on this machine, by its products, its memory traffic and its operations' overhead.

    Returns:
        Of the rollout: "flop" of all products, "bytes" that its operations read and write, number of "operations". Of
        the machine, measured: "flop_per_second" (products as large as the model's), "bytes_per_second" (sums of values
        that no cache holds), "operations_per_second" (of one value). What they ask for together: "product_seconds",
        "memory_seconds", "overhead_seconds".
    """
    state, actions = batch_state([scene] * samples), _actions(samples, horizon, model.action_size)
    with torch.no_grad(), FlopCounterMode(display=False) as flop, _Traffic() as traffic:
        rollout(model, state, actions)
    left, right = torch.rand(8 * samples, 96), torch.rand(96, 192)
    large, small = torch.rand(1 << 26), torch.rand(1)
    measured: dict[str, float] = {
        "flop": float(flop.get_total_flops()),
        "bytes": float(traffic.bytes),
        "operations": float(traffic.operations),
        "flop_per_second": 2.0 * left.numel() * right.shape[1] / _median(partial(torch.mm, left, right), 50),
        "bytes_per_second": large.numel() * 4 / _median(large.sum, 9),
        "operations_per_second": 1.0 / _median(partial(torch.add, small, small), 1000),
    }
    for name, kind in (("product", "flop"), ("memory", "bytes"), ("overhead", "operations")):
        measured[f"{name}_seconds"] = measured[kind] / measured[f"{kind}_per_second"]
    return measured


def perception_times(task: Task, completer: str, scenes: int = 20) -> dict[str, dict[str, float]]:
    """Median seconds from a depth image of the D455's model and joint angles to a scene, without SAM3.

    Args:
        task: of the scenes, each seen twice: at reset, and one random action later.
        completer: as of :func:`~pwm_gym.completion.build_completer`.
        scenes: of the planning-validation seeds.

    Returns:
        "first" (with completion) and "later" (tracked) views: seconds of each stage, and of "all". "ray-cast": of one
        view of :data:`~pwm_gym.cameras.viewpoints.CAMERA`.
    """
    spent: dict[str, list[dict[str, float]]] = {"first": [], "later": []}
    with gym.make(f"pwm/{task.name}Sim-v0") as env:
        twin: Any = env.unwrapped
        meshes, layout = twin.simulator.meshes(), task.layout
        clouds = sample_clouds(meshes, layout, task.cloud_seed)
        look = build_observer(task, layout, meshes, clouds, completer, sensor="d455")
        env.action_space.seed(0)
        for seed in seed_range("plan_validation", scenes):
            env.reset(seed=seed)
            scene = twin.scene()
            look.reset(seed)
            spent["first"].append(look(scene).seconds)
            env.step(env.action_space.sample())
            spent["later"].append(look(twin.scene()).seconds)
        poses = batch_state([scene]).poses()[0].numpy()
    caster = RayCaster(meshes, layout)
    rows = {name: [{**s, "all": sum(s.values())} for s in each] for name, each in spent.items()}
    return {
        "ray-cast": {"all": _median(partial(caster.view, CAMERA, poses), 9)},
        **{name: {k: float(np.median([r[k] for r in each])) for k in each[0]} for name, each in rows.items()},
    }


class _Traffic(TorchDispatchMode):
    """Counts operations that are no views, and the bytes of their arguments and results."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # of PyTorch
        self.operations, self.bytes = 0, 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        if not func.is_view:
            self.operations += 1
            tensors = (x for x in tree_leaves((args, kwargs, result)) if isinstance(x, torch.Tensor))
            self.bytes += sum(x.numel() * x.element_size() for x in tensors)
        return result


def compare_planners(
    model: WorldModel, task: Task, scenes: Sequence[Scene], steps: int = 20, samples: int = 100, horizon: int = 10
) -> dict[str, dict[str, float]]:
    """Our MPPI, ``pytorch_mppi``'s and TorchRL's, each with our model and cost inside, in the model itself.

    Args:
        model: to plan with, and in.
        task: of the scenes.
        scenes: that the episodes begin with.
        steps: actions of an episode.
        samples: action sequences of each plan.
        horizon: of each plan.

    Returns:
        For each planner the median seconds of an action, and the planning cost of the state after ``steps`` actions,
        mean over the scenes.
    """
    config = MPPIConfig(horizon=horizon).resize(samples)
    makers: dict[str, Callable[[FlatModel, Scene], Callable[[torch.Tensor], torch.Tensor]]] = {
        "pwm_gym": lambda flat, scene: _ours(flat, scene, model, task, config),
        "pytorch_mppi": lambda flat, scene: _pytorch_mppi(flat, task, config),
        "torchrl": lambda flat, scene: _torchrl(flat, scene, config),
    }
    table = {}
    for name, make in makers.items():
        seconds, costs = [], []
        for seed, scene in enumerate(scenes):
            torch.manual_seed(seed)
            flat = FlatModel(model, scene)
            act, state = make(flat, scene), flat.vector(scene)
            with torch.no_grad():
                for _ in range(steps):
                    begun = time.perf_counter()
                    action = act(state).clamp(-1.0, 1.0)
                    seconds.append(time.perf_counter() - begun)
                    state = flat.step(state, action)
                costs.append(float(flat.cost(state, action)))
        table[name] = {"seconds": float(np.median(seconds)), "final_cost": float(np.mean(costs))}
    return table


def _ours(
    flat: FlatModel, scene: Scene, model: WorldModel, task: Task, config: MPPIConfig
) -> Callable[[torch.Tensor], torch.Tensor]:
    planner, generator = build_planner(config, task.control), torch.Generator().manual_seed(0)
    objective = RolloutObjective(model, get_cost(task.plan_cost), get_grasp(task.grasp))
    goal = torch.as_tensor(scene.goal)[None]

    def act(state: torch.Tensor) -> torch.Tensor:
        return planner.plan(objective.begin(flat.state(state), goal), generator)[0, 0]

    return act


def _pytorch_mppi(flat: FlatModel, task: Task, config: MPPIConfig) -> Callable[[torch.Tensor], torch.Tensor]:
    from pwm_gym.planning.adapters.pytorch_mppi import pytorch_mppi

    sigma = tuple(max(s, _LEAST_NOISE) for s in config.noise.resolve(task.control).sigma)
    act: Callable[[torch.Tensor], torch.Tensor] = pytorch_mppi(flat, sigma, config.samples, config.horizon).command
    return act


def _torchrl(flat: FlatModel, scene: Scene, config: MPPIConfig) -> Callable[[torch.Tensor], torch.Tensor]:
    from tensordict import TensorDict

    from pwm_gym.planning.adapters.torchrl import TorchRLEnv, torchrl_mppi

    env = TorchRLEnv(flat, flat.vector(scene))
    planner = torchrl_mppi(env, config.samples, config.elites, config.horizon)

    def act(state: torch.Tensor) -> torch.Tensor:
        action: torch.Tensor = planner(TensorDict({"state": state}, []))["action"]
        return action

    return act


def _actions(samples: int, horizon: int, size: int) -> torch.Tensor:
    return torch.rand(samples, horizon, size, generator=torch.Generator().manual_seed(0)) * 2 - 1


def _median(run: Callable[[], Any], repeats: int) -> float:
    """Median seconds of a call, after one that is not counted."""
    run()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        run()
        times.append(time.perf_counter() - begun)
    return float(np.median(times))
