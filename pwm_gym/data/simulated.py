"""The objects of episodes, in a simulator: whether there are such, and what they look like."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pwm_gym.data.dataset import Dataset
from pwm_gym.scene import Scene
from pwm_gym.sim import Simulator
from pwm_gym.tasks import Task

if TYPE_CHECKING:
    import trimesh

__all__ = ["SceneMeshes", "check_objects", "simulator_of"]


def check_objects(task: Task, objects: str) -> None:
    """Refuse objects that a task's simulator cannot have, before hours of work for them; "" is its default.

    Raises:
        PwmGymError: naming them and what there is.
    """
    if objects:
        task.make_simulator(objects).close()


def simulator_of(task: Task, dataset: Dataset) -> Simulator:
    """A simulator of the task whose own episodes draw from the objects of a data set.

    Raises:
        MissingAssetsError: one of them is not on this machine.
    """
    if not task.object_sets:
        return task.make_simulator()
    named = {asset for assets in dataset.combinations for asset in assets}
    return task.make_simulator(sorted(named - {*dataset.layout.names}))  # an asset that never differs has no other name


class SceneMeshes:
    """Surfaces of scenes' entities, asked for once a combination of assets.

    Args:
        simulator: of the task; it starts from the scenes.
    """

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._found: dict[tuple[str, ...], Mapping[str, trimesh.Trimesh]] = {}

    def __call__(self, scene: Scene) -> Mapping[str, trimesh.Trimesh]:
        """Each entity's surface in its own frame, metres; the scene needs joint positions."""
        if scene.assets not in self._found:
            self._simulator.restore(scene)
            self._found[scene.assets] = self._simulator.meshes()
        return self._found[scene.assets]
