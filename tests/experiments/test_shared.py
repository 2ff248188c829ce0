import json

import numpy as np
import pytest

from pwm_gym.dynamics import SceneBank, build_model, save_checkpoint
from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation.text import shared_text
from pwm_gym.experiments import run_shared_table
from pwm_gym.tasks import get_task

TASK = get_task("PickCube")


@pytest.fixture
def folder(train_split, tmp_path):
    """A checkpoint that predicts that nothing moves."""
    model = build_model("still", TASK.layout, TASK.control)
    episode = train_split.episodes[0]
    clouds = train_split.scene(episode).clouds
    goals, places = np.asarray(episode.goal)[None], np.zeros(1, int)
    bank = SceneBank("PickCube", TASK.layout, clouds[None], episode.poses[:1], goals, places)
    save_checkpoint(tmp_path / "still", model, "still", [bank], {}, {})
    return tmp_path / "still"


def test_a_checkpoint_is_evaluated_on_its_tasks(folder, data_folder, tmp_path):
    data = {"PickCube": data_folder}
    table = run_shared_table([folder], ["PickCube"], data, tmp_path / "out", episodes=0)
    (row,) = table["rows"]
    assert (row["row"], row["trained_on"]) == (str(folder), ["PickCube"])
    result = row["tasks"]["PickCube"]
    assert result["splits"]["practice"]["chamfer_l1"] > 0.001 and result["planning"] is None
    assert "PickCube" in shared_text(table) and "practice 0.0" in shared_text(table)
    (path,) = (tmp_path / "out").glob("shared-*/result.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), "commit": "kept"}))
    again = run_shared_table([folder], ["PickCube"], data, tmp_path / "out", episodes=0)
    assert again["rows"][0]["tasks"]["PickCube"]["commit"] == "kept"


def test_tasks_that_no_checkpoint_knows_are_named(folder, data_folder, tmp_path):
    with pytest.raises(PwmGymError, match="none of the checkpoints was trained on StackCube"):
        run_shared_table([folder], ["PickCube", "StackCube"], {"PickCube": data_folder}, tmp_path)
    with pytest.raises(PwmGymError, match="objects='unseen'; the objects of PickCube are always the same"):
        run_shared_table([folder], ["PickCube"], {"PickCube": data_folder}, tmp_path, objects="unseen")
    with pytest.raises(PwmGymError, match="expected --checkpoints FOLDER"):
        run_shared_table([], ["PickCube"], {}, tmp_path)
