"""One large problem over processes: the bits of one process, also where a worker is killed."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from tests.book.books import SHORT, InProcess
from tests.book.fragile import MARK, dies_once
from tests.book.test_bits import dask, ray
from tests.miniatures import thirty_days

from snapo.book.executors import worker_pools
from snapo.cli.main import main
from snapo.engine import Workers
from snapo.engine.native import distributed
from snapo.study.domain import CaseRequest, Options, load


class Counting(InProcess):
    """Counts its jobs."""

    def __init__(self):
        self.jobs = 0

    def submit(self, fn, /, *args, **kwargs):
        self.jobs += 1
        return super().submit(fn, *args, **kwargs)


@pytest.fixture(scope="module")
def case(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("store")
    for name, text in thirty_days().items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def setup(case):
    settings = tuple(f"{key}={value}" for key, value in SHORT.items())
    loaded = load(CaseRequest(case, settings, None))
    return loaded.domain.study(loaded.case, Options()).setup()


@pytest.fixture(scope="module")
def alone(setup):
    """The solution of one process."""
    return setup.solve()


def equal(one, two) -> None:
    for x, y in zip(jax.tree.leaves(one.policy), jax.tree.leaves(two.policy), strict=True):
        np.testing.assert_array_equal(x, y)
    assert (one.value, one.standard_error) == (two.value, two.standard_error)
    for name, held in one.sensitivities.held.items():
        np.testing.assert_array_equal(two.sensitivities.held[name].blocks, held.blocks)


@pytest.mark.prove
def test_a_solution_has_the_same_bits(setup, alone, monkeypatch):
    monkeypatch.setattr(distributed, "MIN_SECONDS", 0.0)
    executors = [Counting(), Counting()]
    solution = setup.solve(executor=executors)
    equal(solution, alone)
    assert all(executor.jobs > 10 for executor in executors)
    assert solution.notes == alone.notes


@pytest.mark.prove
def test_small_steps_have_one_note(setup, alone, monkeypatch):
    monkeypatch.setattr(distributed, "MIN_SECONDS", 1e3)
    executor = Counting()
    solution = setup.solve(executor=executor)
    assert executor.jobs == 0
    (note,) = set(solution.notes) - set(alone.notes)
    assert note.startswith("Workers were not used: the paths of a step take ")


def test_another_engine_is_refused(case, capfd):
    command = ["solve", str(case), "--out", str(case / "run"), "--engine", "xla", "--workers", "2"]
    assert main(command) == 2
    assert "only the native engine uses workers, but this is XLA" in capfd.readouterr().err
    assert not (case / "run").exists()


@pytest.mark.study
def test_the_command_has_the_same_result(case, tmp_path, monkeypatch, capfd):
    """`--on MODULE:FUNCTION`: values, derivatives and notes."""
    monkeypatch.setattr(distributed, "MIN_SECONDS", 0.0)
    (tmp_path / "mine.py").write_text(
        "from tests.book.test_training import Counting\n"
        "made = [Counting(), Counting()]\ndef two():\n    return made\n"
    )
    monkeypatch.chdir(tmp_path)
    settings = [x for key, value in SHORT.items() for x in ("--set", f"{key}={value}")]
    results = []
    for more in ([], ["--on", "mine:two"]):
        out = str(tmp_path / f"run{len(results)}")
        assert main(["solve", str(case), "--out", out, "--json", *settings, *more]) == 0
        results.append(json.loads(capfd.readouterr().out))
    for key in ("value", "standard_error", "policy_gradient_norm", "notes"):
        assert results[0][key] == results[1][key], key
    import mine  # pyright: ignore[reportMissingImports]

    assert all(executor.jobs for executor in mine.made)


@pytest.mark.parametrize(
    "cluster",
    [pytest.param(dask, marks=pytest.mark.prove), pytest.param(ray, marks=pytest.mark.study)],
)
def test_clusters_have_the_same_bits(cluster, setup, alone, monkeypatch):
    monkeypatch.setattr(distributed, "MIN_SECONDS", 0.0)
    with cluster() as pools, Workers(pools) as workers:
        engines = setup.engines.over(workers)
        equal(setup._replace(engines=engines).solve(), alone)
    assert workers.parallel == 2 and engines.train.distributed.runs > 2


@pytest.mark.prove
def test_a_killed_worker_changes_no_bit(setup, alone, tmp_path, monkeypatch):
    """Two processes; one is killed with a result that it has not given."""
    monkeypatch.setattr(distributed, "MIN_SECONDS", 0.0)
    monkeypatch.setenv(MARK, str(tmp_path / "killed"))
    monkeypatch.setattr(distributed, "compute", dies_once)
    with Workers(worker_pools("", 2)) as workers:
        engines = setup.engines.over(workers)
        solution = setup._replace(engines=engines).solve()
        assert engines.train.distributed.runs > 2
    assert (tmp_path / "killed").exists()
    equal(solution, alone)
    assert solution.notes == alone.notes
