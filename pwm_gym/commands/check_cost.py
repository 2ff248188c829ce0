"""``pwm-gym check-cost``."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pwm_gym.errors import PwmGymError

if TYPE_CHECKING:
    from torch import Tensor

    from pwm_gym.costs import Cost
    from pwm_gym.scene import RigidState
    from pwm_gym.tasks import Task

__all__ = ["CheckCost", "find_cost"]


@dataclass(frozen=True)
class CheckCost:
    """Check a cost function of your own on real scenes: shape, values, gradient and batch independence."""

    cost: str
    """A registered name, a weighted sum such as "0.7 * reach + 0.3 * place", or "file.py:function"."""
    task: str = "PickCube"
    """Registered task."""
    picture: Path | None = None
    """PNG to draw the cost into: over a scene of the checkpoint's bank, as one of its entities is moved."""
    move: str | None = None
    """Entity that is moved; None moves the first hand."""

    def run(self) -> None:
        """Print what the cost gives; an error names what is wrong."""
        import torch

        from pwm_gym.costs import cost_info, get_cost, get_grasp
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.scene import batch_state
        from pwm_gym.tasks import get_task

        task = get_task(self.task)
        cost = get_cost(find_cost(self.cost))
        bank = load_checkpoint(resolve("default", task.name)).bank(task.name)
        state = batch_state([bank.scene(i) for i in range(8)])
        frames = state.frames.requires_grad_(True)
        goal = torch.as_tensor(bank.goals[:8])
        action = torch.zeros(8, task.action_size)
        points, info = cost_info(state, action, goal, get_grasp(task.grasp))
        terms = cost.evaluate(points, info)
        for name, value in terms.items():
            print(f"  {name:16s} {float(value.detach().min()):9.4f} to {float(value.detach().max()):9.4f}")
        total = torch.stack(list(terms.values())).sum(0)
        one = state.map(lambda x: x[:1])
        alone = cost(*cost_info(one, action[:1], goal[:1], get_grasp(task.grasp)))
        if not torch.allclose(alone, total[:1], atol=1e-5):
            raise PwmGymError(f"cost {cost.name!r} of a scene depends on its batch: {alone} alone, {total[:1]} among 8")
        smooth = total.requires_grad and bool(torch.autograd.grad(total.sum(), frames)[0].abs().sum() > 0)
        print(f"cost {cost.name!r} is fine on 8 scenes; {'differentiable' if smooth else 'without a gradient here'}")
        if self.picture is not None:
            first = batch_state([bank.scene(0)])
            self._draw(self.picture, task, cost, first, goal[:1], action[:1])

    def _draw(self, path: Path, task: Task, cost: Cost, state: RigidState, goal: Tensor, action: Tensor) -> None:
        from pwm_gym.costs import get_grasp
        from pwm_gym.viewer.cost_map import cost_maps, draw_cost_maps

        entity = self.move or task.layout.names[task.layout.hands[0]]
        draw_cost_maps(path, cost_maps(cost, get_grasp(task.grasp), state, goal, action, entity), cost, entity)
        print(f"  {path}")


def find_cost(name: str) -> str | Callable[..., Any]:
    """A registered name as it is, or the function of a file.

    Raises:
        PwmGymError: there is no such file, it fails on import, or has no such function.
    """
    path, _, function = name.partition(":")
    if not function:
        return name
    if not Path(path).exists():
        raise PwmGymError(f"no file {path!r}; expected a registered cost or 'file.py:function'")
    spec = importlib.util.spec_from_file_location("user_cost", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # of a user's file: whatever it may be
        raise PwmGymError(f"{path} fails on import: {type(error).__name__}: {error}") from error
    if not hasattr(module, function):
        raise PwmGymError(f"{path} has no function {function!r}")
    return getattr(module, function)
