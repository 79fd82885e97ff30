"""The same bits on any executor, in any process, and from `snapo.solve`."""

import contextlib
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.book.books import HERE, results_of, write_book

from snapo.book.executors import worker_pools
from snapo.book.file import read_book
from snapo.book.run import Shard, run_book
from snapo.case.load import load
from snapo.study.assign import assigned
from snapo.study.domain import Options, find

ROWS = [
    {
        "name": f"store {i}",
        "contract.injection_cost": round(0.02 + 0.01 * i, 2),
        "model.volatility": round(0.6 + 0.05 * i, 2),
        "contract.inventory": 10.0 if i % 2 else 12.0,
    }
    for i in range(12)
]


def solved(file: Path, row):
    """`snapo.solve` of a contract's own case."""
    path, data = load(file.parent / "store")
    settings = [f"{key}={value}" for key, value in row.items() if "." in key]
    data, _ = assigned(data, [*settings, "training.seed=0", "evaluation.paths=512"])
    for key, value in {"steps": 2, "paths": 32, "validation_paths": 64}.items():
        data["training"][key] = value
    for key, value in (("sensitivity_paths", 128), ("judge_paths", 0), ("selection_paths", 0),
                       ("search_paths", 0)):  # fmt: skip
        data["evaluation"][key] = value
    domain = find("gas-storage", "")
    setup = domain.study(domain.read(path, data), Options()).setup()
    return setup.solve()


def equal_to_solve(result, solution, tmp_path):
    solution.policy.save(tmp_path / "policy.npz")
    point = result.points[0]
    assert point.value == solution.value
    assert (tmp_path / "policy.npz").read_bytes() == result.policy
    for delta in point.deltas:
        blocks = solution.sensitivities.held[delta.input].blocks
        np.testing.assert_array_equal(blocks.reshape(delta.blocks.shape), delta.blocks)


@pytest.mark.study
def test_a_contract_equals_solve(tmp_path):
    file = write_book(tmp_path, ROWS[1:2])
    run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "run")
    result = results_of(read_book(file), tmp_path / "run")["store 1"]
    equal_to_solve(result, solved(file, ROWS[1]), tmp_path)


@contextlib.contextmanager
def dask():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        yield worker_pools(f"dask:{cluster.scheduler_address}")


@contextlib.contextmanager
def ray():
    # On the loopback address Ray takes a cluster for one of Windows otherwise, as it is imported.
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
    pytest.importorskip("ray")
    # Workers import the tests by the same path as this process.
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    command = [str(Path(sys.executable).with_name("ray"))]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ["--head", "--num-cpus=2", "--node-ip-address=127.0.0.1", f"--port={port}"]
    quiet = ["--include-dashboard=false", "--disable-usage-stats"]
    subprocess.run([*command, "start", *options, *quiet], check=True, capture_output=True)
    try:
        yield worker_pools(f"ray:127.0.0.1:{port}")
    finally:
        subprocess.run([*command, "stop", "--force"], check=False, capture_output=True)


@pytest.mark.prove
def test_twelve_contracts_on_every_executor(tmp_path):
    """Values, derivatives and policies at three points: one worker and two, two shards, Dask, Ray;
    and three of them from `snapo.solve`."""
    file = write_book(tmp_path, ROWS)
    book = read_book(file)

    def valued(name, where):
        result = run_book(read_book(file), lambda _: None, where, out=tmp_path / name)
        assert result["status"] == "ok", result["failures"]
        return {x: result.pack() for x, result in results_of(book, tmp_path / name).items()}

    one = valued("one", worker_pools("", 1))
    assert len(one) == 12
    assert valued("two", worker_pools("", 2)) == one
    for part in (1, 2):
        run_book(
            read_book(file), lambda _: None, HERE, out=tmp_path / "parts", shard=Shard(part, 2)
        )
    assert {x: a.pack() for x, a in results_of(book, tmp_path / "parts").items()} == one
    for name, cluster in (("dask", dask), ("ray", ray)):
        with cluster() as where:
            assert valued(name, where) == one, name
    for i in (0, 5, 11):
        result = results_of(book, tmp_path / "one")[f"store {i}"]
        equal_to_solve(result, solved(file, ROWS[i]), tmp_path)
