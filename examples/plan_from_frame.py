"""From one depth image and the joint angles to a plan, as with a real camera.

python examples/plan_from_frame.py                          # records a view of the simulator first
python examples/plan_from_frame.py --frame FILE_OR_FOLDER   # yours: see pwm_gym.perception.load_frames
"""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import gymnasium as gym
import numpy as np
import tyro

import pwm_gym
from pwm_gym.cameras.viewpoints import CAMERA, CAMERA_SCALE
from pwm_gym.completion import build_completer
from pwm_gym.perception import FrameRenderer, MaskSegmenter, SceneObserver, load_frames
from pwm_gym.scene import batch_state
from pwm_gym.tasks import get_task


@dataclass
class Args:
    """Settings."""

    frame: Path | None = None
    """A frame with joints and with a mask of the cube: an .npz file, or a folder of recorded images."""
    goal: tuple[float, float, float] = (0.55, 0.1, 0.2)
    """Where the cube is to go, metres in the robot base's frame."""
    completer: str = "default"
    """Of the cube: the shipped network, a checkpoint's folder, or "hull"."""
    steps: int = 3
    """Actions that are planned, each from what the model foresees of the last."""


def record(path: Path) -> None:
    """What a RealSense D455 might see of the simulator, with the cube's mask."""
    task = get_task("PickCube")
    with gym.make("pwm/PickCubeSim-v0") as twin:
        twin.reset(seed=400_000)
        scene, meshes = twin.unwrapped.scene(), twin.unwrapped.simulator.meshes()
    render = FrameRenderer(meshes, task.layout, CAMERA.resize(CAMERA_SCALE), "d455")
    frame = render(scene, np.random.default_rng(0))
    masks = {"cube": frame.segmentation == task.layout.names.index("cube")}
    replace(frame, segmentation=None, masks=masks).save(path)


def main(args: Args) -> None:
    """Complete the view, and plan from it."""
    if args.frame is None:
        with TemporaryDirectory() as folder:
            record(Path(folder) / "view.npz")
            frame = load_frames(Path(folder) / "view.npz")[0]
    else:
        frame = load_frames(args.frame)[0]

    task = get_task("PickCube")
    completer = build_completer(args.completer)
    observer = SceneObserver("PickCube", task.layout, task.robot.cloud(), MaskSegmenter(), completer)
    seen = observer(frame, np.array(args.goal, np.float32))
    cube = batch_state([seen.scene]).entity("cube")[0].mean(0)
    print(f"the cube is at {cube.numpy().round(3)}, expected error {1e3 * seen.errors['cube']:.1f} mm")
    print(", ".join(f"{stage} {1e3 * seconds:.0f} ms" for stage, seconds in seen.seconds.items()))

    env = gym.make("pwm/PickCube-v0")
    env.reset(options={"scene": seen.scene})
    agent = pwm_gym.planning.Agent(env.unwrapped.model, "PickCube")
    agent.look(seen.scene)
    for step in range(args.steps):
        action = agent.act()
        agent.advance(action)
        _, reward, *_ = env.step(action)
        print(f"step {step}  action {action.round(2)}  reward {reward:.3f}")


if __name__ == "__main__":
    main(tyro.cli(Args))
