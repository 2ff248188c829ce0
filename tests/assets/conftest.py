import pytest


@pytest.fixture(scope="module")
def shapes(only_shapes):
    """Folder of the generated shapes."""
    return only_shapes
