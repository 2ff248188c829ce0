"""MuJoCo models that tests write, and what they do with them."""

import numpy as np

from pwm_gym.scene import Layout, Scene
from pwm_gym.sim.mujoco import MujocoSimulator

ROBOT = """
    <body name="pusher" pos="-0.3 0 0.035">
      <joint name="x" type="slide" axis="1 0 0" damping="5" range="-1 1"/>
      <geom type="sphere" size="0.03" mass="0.3"/>
    </body>"""
ACTUATOR = '<actuator><position joint="x" kp="100" ctrlrange="-0.5 0.5"/></actuator>'


def xml(world: str, more: str = "", actuator: str = ACTUATOR) -> str:
    plane = '<geom type="plane" size="2 2 0.1"/>'
    return f'<mujoco><compiler angle="radian"/><worldbody>{plane}{ROBOT}{world}</worldbody>{more}{actuator}</mujoco>'


SPHERE = '<geom size="0.02"/>'


def make(text, *names, **options):
    return MujocoSimulator.from_xml(text, {name: name for name in names}, **options)


def scene_of(simulator, last, goal=(), joints=None):
    """The scene of the last three poses, newest first."""
    names = simulator.assets()
    layout = Layout.build([(name, 4) for name in names])
    joints = simulator.joints() if joints is None else joints
    return Scene("X", layout, np.zeros((layout.points, 3), np.float32), np.stack(last), np.array(goal), joints)


def run(simulator, actions):
    """Poses (T + 1, E, 7) under actions (T, A)."""
    out = [simulator.poses()]
    for action in actions:
        simulator.step(action)
        out.append(simulator.poses())
    return np.array(out)
