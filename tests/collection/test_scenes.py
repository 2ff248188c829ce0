import shutil

import gymnasium as gym
import numpy as np
import pytest

from pwm_gym.cli import main
from pwm_gym.collection.scenes import simulated_bank
from pwm_gym.dynamics import load_checkpoint, resolve
from pwm_gym.errors import PwmGymError
from pwm_gym.tasks import get_task


@pytest.mark.filterwarnings("ignore:.*was trained without joints:UserWarning")
def test_a_checkpoint_gets_scenes_of_a_task_that_it_was_never_trained_on(tmp_path, capsys):
    folder = tmp_path / "panda"
    shutil.copytree(resolve("panda", "PickCube"), folder)
    before = load_checkpoint(folder)
    main(["scenes", str(folder), "--task", "MugCleanup", "--count", "3"])
    assert "3 scenes of MugCleanup; the model was never trained on it" in capsys.readouterr().out
    after = load_checkpoint(folder)
    assert after.tasks == before.tasks and "MugCleanup" not in after.seen_tasks
    bank = after.bank("MugCleanup")
    assert len(bank) == 3 and all(names[-1].startswith("mug_") for names in bank.assets)
    assert not np.array_equal(bank.poses[0], bank.poses[1])
    with gym.make("pwm/MugCleanup-v0", checkpoint=str(folder), disable_env_checker=True) as env:
        observation, info = env.reset(seed=0)
        assert observation["points"].shape == (8192, 3) and info["stage"] == "open drawer"
        for _ in range(3):
            env.step(np.zeros(7, np.float32))


def test_no_scenes_are_refused():
    with pytest.raises(PwmGymError, match="count=0; expected at least 1"):
        simulated_bank(get_task("PickCube"), 0)
