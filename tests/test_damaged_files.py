"""Whatever happens to a file, reading it ends in one of the package's own errors."""

import json
import random
import shutil

import pytest
from damage import edit_json
from fuzz import fuzz
from samples import LAYOUT, make_samples

from pwm_gym.errors import PwmGymError
from pwm_gym.scene import Layout

FILES = 148  # four of each kind; `python benchmarks/fuzz.py --files 10000` damages more
LAYOUTS = 300
ARRAYS = ("scene", "shard", "run", "frame")


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    return make_samples(tmp_path_factory.mktemp("samples"))


def test_damaged_files_end_in_a_clear_error(tmp_path):
    tallies = dict(fuzz(FILES, tmp_path))
    assert not {name: tally.failures for name, tally in tallies.items() if tally.failures}
    assert sum(tally.files for tally in tallies.values()) == FILES
    assert sum(tally.refused for tally in tallies.values()) > FILES // 2


@pytest.mark.parametrize("kind", ARRAYS)
@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\xff" * 64, b"[" * 100_000], ids=["empty", "zip", "ones", "deep"]
)
def test_other_files_end_in_a_clear_error(kind, content, samples):
    samples[kind].path.write_bytes(content)
    with pytest.raises(PwmGymError, match=kind):
        samples[kind].read()


@pytest.mark.parametrize("kind", ARRAYS)
def test_a_folder_in_a_files_place_ends_in_a_clear_error(kind, samples):
    path = samples[kind].path
    path.unlink(missing_ok=True)
    path.mkdir()
    with pytest.raises(PwmGymError, match=kind):
        samples[kind].read()
    shutil.rmtree(path)
    with pytest.raises((PwmGymError, FileNotFoundError), match=kind):
        samples[kind].read()


def test_layouts_of_any_json_end_in_a_clear_error():
    whole = json.loads(json.dumps(LAYOUT.to_json()))
    refused = 0
    for number in range(LAYOUTS):
        try:
            Layout.from_json(edit_json(whole, random.Random(number)))
        except PwmGymError:
            refused += 1
        except Exception as error:
            raise AssertionError(f"damage {number}: {type(error).__name__}: {error}") from error
    assert refused > LAYOUTS // 2
