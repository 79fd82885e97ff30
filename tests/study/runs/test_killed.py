"""kill -9 of a run at any moment leaves the others and `run` whole."""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from snapo.cli.main import main
from snapo.problem.carry.latest import target
from snapo.study.runs import store
from snapo.study.runs.store import is_locked

ROOT = Path(__file__).parents[3]


def begin(case: Path, seconds: float) -> subprocess.Popen:
    command = [sys.executable, "-m", "tests.study.runs.solving", str(case), str(seconds)]
    # Of the folder with `tests`, which is not installed.
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*.*")}


@pytest.mark.prove
def test_killed_runs_leave_the_others_whole(fake, case, capsys):
    """Twelve processes, four at a time, of which every other one is killed at random."""
    chance, ended = random.Random(7), 0
    assert main(["solve", str(case)]) == 0
    first = store.folders(case)[0]
    before = contents(first)
    for batch in range(3):
        # In the first batch those to be killed are long enough to be in the middle of it then.
        several = [begin(case, 0.1 if batch or i % 2 else 2.0) for i in range(4)]
        try:
            count = len(store.folders(case))
            deadline = time.monotonic() + 120
            while len(store.folders(case)) == count and time.monotonic() < deadline:
                time.sleep(0.01)
            for process in several[::2]:
                time.sleep(chance.uniform(0, 0.4))
                process.send_signal(signal.SIGKILL)
            codes = [process.wait(120) for process in several]
        finally:
            for process in several:
                process.kill()
        assert codes[1] == codes[3] == 0, batch
        ended += 2
    good = [run for run in store.folders(case) if store.is_good(run)]
    assert len(good) >= 1 + ended
    assert target(case / "run") in good
    assert contents(first) == before
    for run in good:
        assert json.loads((run / "result.json").read_text())["value"] == 7
        assert not is_locked(run / store.LOCK)
    reported = [run for run in good if (run / "report.html").exists()]
    assert len(reported) >= 1 + ended
    # A run that was killed between its numbers, which are whole, and its report, made from them.
    for run in set(good) - set(reported):
        assert main(["report", str(run)]) == 0 and (run / "report.html").exists()
    killed = [run for run in store.folders(case) if run not in good]
    assert killed, "none was killed in the middle"
    capsys.readouterr()
    assert main(["runs", str(case)]) == 0
    assert "stopped" in capsys.readouterr().out
    assert main(["solve", str(case), "--resume"]) == 0
    assert main(["runs", str(case), "--remove", *(run.name for run in killed)]) == 0
