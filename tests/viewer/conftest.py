import numpy as np
import pytest

from pwm_gym.scene import Layout
from pwm_gym.viewer import TwinRecord


@pytest.fixture
def record():
    """Ten steps of a small hand and cube; the prediction drifts by 1 mm a step."""
    generator = np.random.default_rng(0)
    layout = Layout.build([("hand", 40), ("cube", 20)], driven=("hand",))
    cloud = np.concatenate([generator.uniform(-0.05, 0.05, (40, 3)), generator.uniform(-0.02, 0.02, (20, 3))])
    path = np.linspace([0.55, -0.1, 0.1], [0.65, 0.1, 0.2], 10)
    true = cloud + path[:, None]
    drift = 0.001 * np.arange(10)
    return TwinRecord(
        predicted=true + drift[:, None, None],
        true=true,
        layout=layout,
        error=drift,
        goal=np.array([0.65, 0.1, 0.2]),
        predicted_reward=-drift,
        true_reward=np.zeros(10),
        title="PickCube",
        subtitle="a test",
    )
