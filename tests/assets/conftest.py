import pytest


@pytest.fixture(scope="session")
def shapes(tmp_path_factory):
    """Folder of the generated shapes."""
    from pwm_gym.assets import generated_assets

    return generated_assets(tmp_path_factory.mktemp("shapes"))
