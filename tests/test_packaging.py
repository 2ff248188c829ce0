import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_every_package_is_installed():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = [p.parent.relative_to(ROOT) for p in (ROOT / "pwm_gym").rglob("__init__.py")]
    own = {".".join(folder.parts) for folder in folders}
    assert set(listed) == own | {"pwm_gym.envs", "pwm_gym.wrappers"}
