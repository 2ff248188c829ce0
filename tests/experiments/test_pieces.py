import importlib
import sys
from functools import partial

import pytest

from pwm_gym.errors import PwmGymError
from pwm_gym.experiments.pieces import Piece, run_pieces

WORK = """
import os

def make(value, folder):
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "made").open("a") as file:
        file.write("x")
    return {"value": value}

def die(value, folder):
    os._exit(1)
"""


@pytest.fixture
def pieces(tmp_path_factory, monkeypatch):
    """``pieces(out, recipes, work)``: pieces of a module that processes of their own can import, too."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "piecework.py").write_text(WORK)
    monkeypatch.syspath_prepend(folder)
    module = importlib.import_module("piecework")

    def make(out, recipes="abc", work="make"):
        return [Piece(f"piece {r}", "kind", r, out, partial(getattr(module, work), r)) for r in recipes]

    yield make
    sys.modules.pop("piecework")


@pytest.mark.parametrize("workers", [1, 2])
def test_missing_pieces_are_made_and_told(pieces, tmp_path, workers):
    lines = []
    results = run_pieces(pieces(tmp_path, "ab"), workers, lines.append)
    assert [r["value"] for r in results] == ["a", "b"] and all("commit" in r for r in results)
    assert lines[0] == f"2 pieces to make, 0 there already, in {tmp_path}"
    assert sorted(x.split("] ")[1] for x in lines[1:]) == ["piece a: 0 s", "piece b: 0 s"]
    assert [x.split("]")[0] for x in lines[1:]] == ["[1/2", "[2/2"]


def test_what_is_there_is_kept_and_shared(pieces, tmp_path):
    run_pieces(pieces(tmp_path, "a"))
    lines = []
    results = run_pieces(pieces(tmp_path, "abb"), tell=lines.append)
    assert [r["value"] for r in results] == ["a", "b", "b"]
    assert lines[0].startswith("1 pieces to make, 1 there already") and len(lines) == 2
    assert [p.read_text() for p in tmp_path.glob("*/made")] == ["x", "x"]
    run_pieces(pieces(tmp_path, "ab"), tell=pytest.fail)


def test_a_damaged_result_is_named(pieces, tmp_path):
    (piece,) = pieces(tmp_path, "a")
    run_pieces([piece])
    piece.result.write_text("{")
    with pytest.raises(PwmGymError, match=r"result\.json is no result .* delete it to make it again"):
        run_pieces([piece])


def test_a_process_that_dies_ends_the_run(pieces, tmp_path):
    with pytest.raises(PwmGymError, match="one of 2 processes died .* the same command goes on where it was"):
        run_pieces(pieces(tmp_path, "ab", "die"), 2, lambda line: None)
