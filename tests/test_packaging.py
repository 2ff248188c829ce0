import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def test_every_package_is_installed():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = [p.parent.relative_to(ROOT) for p in (ROOT / "pwm_gym").rglob("__init__.py")]
    own = {".".join(folder.parts) for folder in folders}
    assert set(listed) == own | {"pwm_gym.envs", "pwm_gym.wrappers"}


@pytest.mark.parametrize("command", [["-c", "import pwm_gym.envs, pwm_gym.wrappers"], ["-m", "pwm_gym", "--help"]])
def test_python_started_in_the_repositorys_root_finds_all_of_the_package(command):
    run = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
