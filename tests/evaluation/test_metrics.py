import json

import numpy as np
import pytest
import torch
from scipy.stats import spearmanr

from pwm_gym.errors import PwmGymError
from pwm_gym.evaluation import chamfer, pearson, planning_table, wilson, write_results
from pwm_gym.evaluation.metrics import spearman


def brute_force(a, b, order):
    gaps = np.linalg.norm(a[:, None] - b[None], ord=order, axis=-1)
    return 0.5 * (gaps.min(1).mean() + gaps.min(0).mean())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("sizes", [(40, 40), (30, 70), (1, 5)])
def test_chamfer_agrees_with_brute_force(order, sizes):
    rng = np.random.default_rng(0)
    a, b = (rng.normal(size=(n, 3)) for n in sizes)
    assert chamfer(a, b, order) == pytest.approx(brute_force(a, b, order))
    assert chamfer(a, b, order) == pytest.approx(chamfer(b, a, order))


def test_chamfer_is_half_the_sum_of_both_directions_in_absolute_coordinates():
    a, b = np.zeros((1, 3)), np.array([[1.0, 2.0, -2.0], [0.0, 0.0, 1.0]])
    assert chamfer(a, b) == pytest.approx(0.5 * (1.0 + (5.0 + 1.0) / 2))
    assert chamfer(a, b, order=2) == pytest.approx(0.5 * (1.0 + (3.0 + 1.0) / 2))
    assert chamfer(b, b) == 0.0


def test_pearson_agrees_with_its_definition():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 50))
    expected = ((a - a.mean()) * (b - b.mean())).mean() / (a.std() * b.std())
    assert pearson(a, b) == pytest.approx(expected)
    assert pearson(a, 3 * a + 1) == pytest.approx(1) and pearson(a, -a) == pytest.approx(-1)


@pytest.mark.parametrize("series", [np.ones(10), np.full(78, 0.3, np.float32), np.array([0.5])])
def test_pearson_of_what_does_not_vary_is_none(series):
    assert pearson(series, np.arange(len(series), dtype=float)) is None


@pytest.mark.parametrize(
    ("successes", "trials", "interval"),
    [  # Newcombe (1998), table I, method 3
        (81, 263, (0.2553, 0.3662)),
        (15, 148, (0.0624, 0.1605)),
        (0, 20, (0.0, 0.1611)),
        (1, 29, (0.0061, 0.1718)),
        (20, 20, (0.8389, 1.0)),
    ],
)
def test_wilson_gives_the_published_intervals(successes, trials, interval):
    assert wilson(successes, trials) == pytest.approx(interval, abs=1e-4)


def test_a_table_of_no_runs_is_refused():
    with pytest.raises(PwmGymError, match="no run is left to tell of"):
        planning_table([])


def test_ranks_agree_with_scipys():
    a, b = np.random.default_rng(0).normal(size=(2, 50)).round(1)  # with ties
    assert spearman(a, b) == pytest.approx(spearmanr(a, b).statistic)
    assert spearman(a, np.exp(a)) == pytest.approx(1.0) and spearman(a, np.ones(50)) is None


def test_wilson_of_nothing_is_everything():
    assert wilson(0, 0) == (0.0, 1.0)


def test_results_are_written_with_what_made_them(tmp_path, monkeypatch):
    torch.set_num_threads(1)
    monkeypatch.setattr("sys.argv", ["/somewhere/pwm_gym/__main__.py", "evaluate", "--members", "a b"])
    values = {"value": np.float32(0.5), "parts": [{"none": float("nan")}, (np.inf, 2, True, None, "x")]}
    write_results(tmp_path / "deep" / "results.json", values)
    record = json.loads((tmp_path / "deep" / "results.json").read_text())
    assert record["value"] == 0.5
    assert record["parts"] == [{"none": None}, [None, 2, True, None, "x"]]
    assert {"command", "date", "commit", "machine"} <= set(record)
    assert record["command"] == "pwm-gym evaluate --members 'a b'"
    assert record["machine"]["torch_threads"] == 1
