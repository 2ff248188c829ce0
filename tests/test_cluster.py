"""Work on a Ray cluster: of two workers on this machine, with the results of one process.

`pip install 'pwm-gym[ray]'`, then `pytest -m slow tests/test_cluster.py`.
"""

import json
import os
import sys
from dataclasses import replace

import numpy as np
import pytest

from pwm_gym.agents.ranking import rank_contestants
from pwm_gym.cli import main
from pwm_gym.cluster import RayWorkers
from pwm_gym.collection import collect
from pwm_gym.errors import DatasetError, PwmGymError
from pwm_gym.planning import Run
from pwm_gym.workers import work_through

BEGUN = []


def test_a_missing_library_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(PwmGymError, match=r"work on many machines needs Ray: pip install 'pwm-gym\[ray\]'"):
        list(work_through(abs, [1], RayWorkers()))
    with pytest.raises(SystemExit, match="pip install 'pwm-gym"):
        main(["plan", "--episodes", "1", "--threads", "1", "--ray", "local"])


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_an_error():
    pytest.importorskip("ray")
    with pytest.raises(PwmGymError, match="no Ray cluster at '127.0.0.1:1' .*start one by `ray start --head`"):
        list(work_through(abs, [1], RayWorkers("127.0.0.1:1")))


@pytest.fixture(scope="module")
def cluster():
    """Two workers on this machine."""
    ray = pytest.importorskip("ray")
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield RayWorkers()
    ray.shutdown()


def begin():
    BEGUN.append(os.getpid())


def begun(job):
    return os.getpid(), [*BEGUN]


@pytest.mark.slow
def test_every_job_is_done_and_begins_once_a_process(cluster):
    assert sorted(work_through(abs, [-1, 2, -3], cluster)) == [1, 2, 3]
    found = dict(work_through(begun, range(6), cluster, begin))
    assert os.getpid() not in found and all(called == [process] for process, called in found.items())


@pytest.mark.slow
def test_an_error_of_a_job_is_its_own(cluster):
    with pytest.raises(ValueError, match="invalid literal for int.*'x'"):
        list(work_through(int, ["1", "x"], cluster))
    with pytest.raises(DatasetError, match="^mine$"):
        list(work_through(fail, ["mine", "mine"], cluster))


def fail(message):
    raise DatasetError(message)


@pytest.mark.slow
def test_a_process_that_dies_is_an_error(cluster):
    with pytest.raises(PwmGymError, match="a process of the cluster died .* the same command goes on where it was"):
        list(work_through(os._exit, [1], cluster))


@pytest.mark.slow
def test_a_cluster_collects_what_one_process_does(cluster, data_config, tmp_path):
    few = replace(data_config, episodes=2, held_out=1, shard=1)
    one = collect(replace(few, out=tmp_path / "one"), progress=False)
    many = collect(replace(few, out=tmp_path / "many"), progress=False, workers=cluster)
    assert {p.name: p.read_bytes() for p in one.iterdir()} == {p.name: p.read_bytes() for p in many.iterdir()}


@pytest.mark.slow
def test_a_cluster_plans_what_one_process_does(cluster, tmp_path):
    args = [
        "plan",
        "--episodes",
        "2",
        "--max-steps",
        "4",
        "--threads",
        "1",
        "--samples",
        "8",
        "--horizon",
        "2",
        "--save",
    ]
    main([*args, str(tmp_path / "one"), "--json", str(tmp_path / "one.json")])
    main([*args, str(tmp_path / "many"), "--json", str(tmp_path / "many.json"), "--ray", "auto"])
    for path in (tmp_path / "one").glob("seed-*.npz"):
        one, many = Run.load(path), Run.load(tmp_path / "many" / path.name)
        np.testing.assert_array_equal(one.actions, many.actions)
        np.testing.assert_array_equal(one.poses, many.poses)
    one, many = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("one", "many"))
    assert one["runs"] == many["runs"] and len(one["runs"]) == 2


@pytest.mark.slow
def test_a_cluster_ranks_what_one_process_does(cluster, tmp_path):
    def rank(name, workers):
        policies = ["random", "expert:0"]
        return rank_contestants(
            policies, "PickCube", tmp_path / name, 2, max_steps=5, workers=workers, tell=lambda _: None
        )

    one, many = rank("one", 1), rank("many", cluster)
    assert one["rows"] == many["rows"] and one["floor"] == many["floor"]
