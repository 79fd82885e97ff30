"""Workers that die, results that are not whole, disks that are full: each result once, and equal."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter, deque
from pathlib import Path

import jax
import numpy as np
import pytest
from tests.book.books import HERE, results_of, write_book
from tests.book.conftest import ROWS
from tests.book.fragile import echo
from tests.domains.energy.energy_cases import battery, plant, swing

from snapo.book import commands, run
from snapo.book.executors import worker_pools
from snapo.book.file import read_book
from snapo.book.folder import BookFolder
from snapo.book.run import Shard, run_book
from snapo.book.work import check_held
from snapo.case.error import CaseError
from snapo.domains.energy.core.policy import UnitValuePolicy
from snapo.engine.workers import Lost, results


def given(jobs, where, work=echo):
    waiting = deque(jobs)
    return list(results(lambda: waiting.popleft() if waiting else None, work, where))


@pytest.mark.study
def test_killed_workers_lose_nothing(tmp_path):
    """60 jobs on two processes; four of them kill theirs the first time, one every time."""
    jobs = [f"job:{i}".encode() for i in range(55)]
    once = [f"once:{tmp_path / str(i)}".encode() for i in range(4)]
    results = given([*jobs[:20], *once, b"poison:", *jobs[20:]], worker_pools("", 2))
    assert Counter(job for job, _ in results) == Counter([*jobs, *once, b"poison:"])
    table = dict(results)
    assert all(table[job] == job + b"!" for job in (*jobs, *once))
    poison = table[b"poison:"]
    assert isinstance(poison, Lost) and "BrokenProcessPool" in poison.reason


DRIVER = """
import os, time
from snapo.book.executors import _process
if __name__ == "__main__":
    print(_process(0).submit(os.getpid).result(), flush=True)
    time.sleep(60)
"""


@pytest.mark.prove
def test_a_worker_ends_with_its_driver(tmp_path):
    """kill -9 of the driver: its worker would wait for ever, with all its memory."""
    (tmp_path / "driver.py").write_text(DRIVER)
    command = [sys.executable, str(tmp_path / "driver.py")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        worker = int(driver.stdout.readline())
        assert _alive(worker)
        driver.kill()
    ended = time.monotonic() + 20
    while _alive(worker) and time.monotonic() < ended:
        time.sleep(0.1)
    assert not _alive(worker)


def _alive(process):
    """Whether a process runs; one that has ended may still wait for its parent."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_an_exception_is_a_loss_too():
    table = dict(given([b"a", b"fails:", b"b", b"other:"], HERE))
    assert table[b"a"] == b"a!" and table[b"b"] == b"b!"
    assert table[b"fails:"] == Lost("MemoryError: too large")
    assert table[b"other:"] == Lost("no worker has a processor of the required kind")


@pytest.mark.prove  # it damages a book that was valued
@pytest.mark.parametrize(
    "text", ["[1]", "{}", '{"sums": 3}', '{"sums": [{"stress": "base"}]}', "3"]
)
def test_a_result_of_another_shape_is_refused(text, valued, tmp_path):
    """The first was a traceback. What was computed stays: `--resume` makes the result again."""
    for name in ("book.json", "result.json"):
        shutil.copy(valued.out / name, tmp_path / name)
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(CaseError, match=r"result.json.* this file was changed .*--resume"):
        commands.report(tmp_path)


@pytest.mark.parametrize(
    ("of", "changes"),
    [
        (battery, {"cycles": {"day": 1.0, "term": 6.0}}),
        (plant, {"before": {"off": 3}}),  # the same shapes, and modes in another order
        (swing, {"annual": None}),
    ],
)
def test_a_policy_is_not_held_where_levels_or_modes_differ(of, changes):
    """A sweep lost the value of the unchanged contract too, with a TypeError; a plant decided by the values
    of other modes."""
    same, other = (
        UnitValuePolicy(case.contract.layout, 99, key=jax.random.key(0))
        for case in (of(), of(**changes))
    )
    check_held(same, UnitValuePolicy(of().contract.layout, 99, key=jax.random.key(1)))
    with pytest.raises(ValueError, match=r"does not fit this one.*--train"):
        check_held(same, other)


def test_an_unreadable_contract_fails_alone(valued, tmp_path):
    """The others have their values; the sum has none, as it would be that of another book."""
    file = write_book(tmp_path, ROWS)
    result = run_book(read_book(file), lambda _: None, HERE, out=valued.out.parent / "with wrong")
    assert result["status"] == "failed" and result["cases"] == {"ok": 4, "failed": 1}
    assert {row["case"] for row in result["failures"]} == {"wrong"}
    assert "max_inventory" in result["failures"][0]["note"]
    assert "-1" in result["failures"][0]["note"]
    assert result["sums"][0]["value"] is None
    assert result["by"]["desk"]["A"][0] == valued.result["by"]["desk"]["A"][0]


def test_resume_computes_what_is_missing(valued, tmp_path):
    """Of a book with one contract changed, that contract; a result that is cut is computed again."""
    rows = [row | {"contract.injection_cost": 0.06} if row["name"] == "dearer" else row
            for row in ROWS[:4]]  # fmt: skip
    file, out = write_book(tmp_path, ROWS[:4]), tmp_path / "run"
    first = run_book(read_book(file), lambda _: None, HERE, out=out)
    before = set(out.glob("answers/*/*"))
    repeated = run_book(
        read_book(write_book(tmp_path, rows)), lambda _: None, HERE, out=out, resume=True
    )
    assert repeated["orders"] == {"computed": 1, "reused": 1, "lost": 0}
    assert repeated["by"]["desk"]["A"] == first["by"]["desk"]["A"]
    assert repeated["sums"][0]["value"] != first["sums"][0]["value"]

    (added,) = set(out.glob("answers/*/*")) - before
    added.write_bytes(added.read_bytes()[:-100])
    complete = run_book(read_book(file), lambda _: None, HERE, out=out, resume=True)
    assert complete["orders"]["computed"] == 1
    assert complete["sums"] == repeated["sums"]


def test_shards_meet(valued, tmp_path):
    """Two parts in one folder give the numbers of the whole, whichever is the last."""
    file, out = write_book(tmp_path, ROWS[:4]), tmp_path / "run"
    second = run_book(read_book(file), lambda _: None, HERE, out=out, shard=Shard(2, 2))
    assert "sums" not in second and not (out / "result.json").exists()
    first = run_book(read_book(file), lambda _: None, HERE, out=out, shard=Shard(1, 2))
    assert first["sums"] == valued.result["sums"]
    assert json.loads((out / "result.json").read_text())["sums"] == first["sums"]


@pytest.mark.prove
def test_a_full_disk_keeps_what_is_written(valued, tmp_path, monkeypatch):
    file, out, written = write_book(tmp_path, ROWS[:4]), tmp_path / "run", []

    def full(folder, name, data):
        if written:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(name)
        before(folder, name, data)

    before = BookFolder.write
    monkeypatch.setattr(BookFolder, "write", full)
    with pytest.raises(CaseError, match=r"No space left on device.*--resume"):
        run_book(read_book(file), lambda _: None, HERE, out=out)
    monkeypatch.undo()
    result = run_book(read_book(file), lambda _: None, HERE, out=out, resume=True)
    assert result["orders"] == {"computed": 1, "reused": 1, "lost": 0}
    assert result["sums"] == valued.result["sums"]


def test_a_lost_job_is_named_and_tried_again(valued, tmp_path, monkeypatch):
    file, out, real = write_book(tmp_path, ROWS[:4]), tmp_path / "run", run.compute

    def dies(job):
        if b"injection_cost = 0.04" in job:
            raise MemoryError("killed")
        return real(job)

    monkeypatch.setattr(run, "compute", dies)
    result = run_book(read_book(file), lambda _: None, HERE, out=out)
    assert result["status"] == "failed" and result["orders"]["lost"] == 1
    assert {(x["case"], x["status"]) for x in result["failures"]} == {("dearer", "lost")}
    assert "killed" in result["failures"][0]["note"]
    monkeypatch.undo()
    result = run_book(read_book(file), lambda _: None, HERE, out=out, resume=True)
    assert result["sums"] == valued.result["sums"]


def test_a_folder_of_something_else_is_not_touched(tmp_path):
    file = write_book(tmp_path, ROWS[:1])
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    with pytest.raises(CaseError, match="this folder has other files"):
        run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "other")
    assert [x.name for x in (tmp_path / "other").iterdir()] == ["notes.txt"]


@pytest.mark.prove
def test_sixty_contracts_with_everything_killed(tmp_path):
    """kill -9 of a worker and then of the driver; the resumed run has the results of a quiet one."""
    rows = [
        {"name": f"store {i}", "contract.injection_cost": round(0.02 + 0.001 * i, 3)}
        for i in range(60)
    ]
    file = write_book(tmp_path, rows, stresses="")
    command = [sys.executable, "-m", "snapo", "book", str(file), "--workers", "2", "--json"]
    out = tmp_path / "run"
    driver = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _wait_for(out, 5)
    workers = subprocess.run(
        ["pgrep", "-P", str(driver.pid), "-f", "spawn_main"], capture_output=True, text=True
    )
    os.kill(int(workers.stdout.split()[0]), signal.SIGKILL)
    count = _wait_for(out, 20)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    assert count < 60
    resumed = subprocess.run([*command, "--resume"], capture_output=True, text=True)
    result = json.loads(resumed.stdout)
    assert result["status"] == "ok" and result["cases"] == {"ok": 60, "failed": 0}
    jobs = result["orders"]
    assert jobs["computed"] + jobs["reused"] == 60 and jobs["reused"] >= 20
    quiet = run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "quiet")
    assert quiet["sums"] == result["sums"]
    book = read_book(file)
    mine, other = results_of(book, out), results_of(book, tmp_path / "quiet")
    for name, result in mine.items():
        assert result.pack() == other[name].pack()
    assert len({float(np.mean(x.points[0].shares)) for x in mine.values()}) == 60


def _wait_for(out, count):
    """Until the folder has so many results."""
    ended = time.monotonic() + 300
    while time.monotonic() < ended:
        found = len(list(out.glob("answers/*/[0-9a-f]*")))
        if found >= count:
            return found
        time.sleep(0.1)
    raise AssertionError("too slow")
