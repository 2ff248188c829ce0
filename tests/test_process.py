import ctypes
import platform
from types import SimpleNamespace

import pytest
import torch

from pwm_gym.process import prepare_process


@pytest.fixture(autouse=True)
def threads():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("count", [1, 2])
def test_threads_are_set(count):
    prepare_process(threads=count)
    assert torch.get_num_threads() == count


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc")
def test_the_c_library_takes_the_settings(monkeypatch):
    taken = []
    library = ctypes.CDLL(None)
    recorded = SimpleNamespace(mallopt=lambda *setting: taken.append(library.mallopt(*setting)))
    monkeypatch.setattr(ctypes, "CDLL", lambda name: recorded)
    prepare_process()
    assert taken == [1, 1]


def test_another_c_library_is_left_alone(monkeypatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    monkeypatch.setattr(ctypes, "CDLL", None)  # it is not asked for
    prepare_process(threads=1)
    assert torch.get_num_threads() == 1
