"""kill -9 at random moments of training, evaluation and writing: every run resumes to the same bits."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from tests.miniatures import MINIATURES

START = 300.0  # seconds that a process has for its first file
AGAIN = "from tests import conftest; from snapo.cli.main import main; import sys; sys.exit(main())"
APART = ("seconds", "versions")  # in which two runs may differ


def command(kind: str, folder: Path, out: Path) -> list[str]:
    """Resumes the case in `folder`, in a process that compiles as the tests do."""
    asked = MINIATURES[kind].request(folder)
    words = ["solve", str(asked.path), "--out", str(out), "--resume"]
    words += [word for each in asked.assignments for word in ("--set", each)]
    words += ["--simulator", ":".join(asked.simulator)] if asked.simulator else []
    return [sys.executable, "-c", AGAIN, *words]


def killed(words: list[str], out: Path, delay: float) -> bool:
    """Starts a run, and kills it so many seconds after its first file; whether it was alive."""
    before = _last(out)
    with (out.parent / "log").open("wb") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log)
        try:
            ends = time.monotonic() + START
            while process.poll() is None and time.monotonic() < ends and _last(out) == before:
                time.sleep(0.005)
            time.sleep(delay)
            process.send_signal(signal.SIGKILL)
            return process.wait(60) == -signal.SIGKILL
        finally:
            process.kill()
            process.wait()


def _last(out: Path) -> int:
    """When the record or the checkpoint was written last."""
    files = (out / "run.json", out / "checkpoint.npz")
    return max((each.stat().st_mtime_ns for each in files if each.exists()), default=0)


def numbers(run: Path) -> dict[str, Any]:
    """All that a run found, without its clocks."""
    tables = {each.name: json.loads(each.read_text()) for each in (run / "parts").iterdir()}
    tables["result"] = json.loads((run / "result.json").read_text()) | {"run": ""}
    return {name: _plain(each) for name, each in tables.items()}


def _plain(table: Any) -> Any:
    if isinstance(table, dict):
        return {key: _plain(each) for key, each in table.items() if key not in APART}
    return [_plain(each) for each in table] if isinstance(table, list) else table


def columns(file: Path) -> dict[str, list[str]]:
    """A table by its columns, without clocks."""
    with file.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.reader(lines))
    found = {name: cells for name, *cells in zip(*rows, strict=True)}
    return {name: cells for name, cells in found.items() if name not in APART}


def same_after(kind: str, solved, tmp_path: Path, moments: int, seconds: float) -> None:
    """So many kills of one run after another, each resumed; then to the end."""
    whole, out, chance = solved(kind), tmp_path / "run", random.Random(f"{kind} {moments}")
    words = command(kind, whole, out)
    alive = sum(killed(words, out, chance.uniform(0, seconds)) for _ in range(moments))
    assert alive >= moments / 2, "the moments are too late: nothing is left to kill"
    assert subprocess.run(words, capture_output=True, env=os.environ).returncode == 0
    assert numbers(out) == numbers(whole / "run")
    tables = sorted(each.name for each in (whole / "run").glob("*.csv"))
    assert tables == sorted(each.name for each in out.glob("*.csv"))
    for name in tables:
        assert columns(out / name) == columns(whole / "run" / name), name
    assert not list(out.rglob("*.partial.*"))


@pytest.mark.prove
def test_a_killed_run_resumes_to_the_same_bits(solved, tmp_path):
    same_after("own", solved, tmp_path, 2, 2.0)


@pytest.mark.study
@pytest.mark.parametrize("kind", sorted(MINIATURES))
def test_thirteen_kills(kind, solved, tmp_path):
    """Of every domain."""
    same_after(kind, solved, tmp_path, 13, 3.0)
