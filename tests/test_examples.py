"""Every example runs as a user would run it, in a tiny setting."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "examples"
TINY = {
    "compare_twins.py": ("--steps 10", "step  10  Chamfer L1"),
    "custom_cost.py": ("--steps 2 --samples 8", "step   1"),
    "own_mujoco_task.py": ("--episodes 2 --steps 7 --plans 1 --max-steps 2", "of 1 boxes reached their goals"),
    "plan_from_frame.py": ("--steps 1 --completer hull", "step 0  action"),
    "plan_pick_cube.py": ("--steps 2 --samples 8 --horizon 2", "step   0  reward 0."),
    "train_sac.py": ("--steps 40 --num-envs 2 --episodes 1 --episode-steps 3", "return in the simulator"),
}


@pytest.mark.parametrize("name", sorted(p.name for p in FOLDER.glob("*.py")))
def test_example(name, tmp_path):
    args, expected = TINY[name]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(FOLDER / name), *args.split()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    assert expected in done.stdout
    assert not list(tmp_path.iterdir())  # it leaves nothing behind
