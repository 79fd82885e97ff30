"""The line with the progress of a training: where someone looks, and nowhere else."""

import io
import sys

import pytest

from snapo.solver.learning import bar
from snapo.solver.learning.bar import ProgressLine, shown


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_it_shows_steps_the_time_left_and_the_best_value(monkeypatch):
    clock, lines = [0.0], []
    monkeypatch.setattr(bar.time, "perf_counter", lambda: clock[0])
    line = ProgressLine(lines.append)
    for step in range(1, 101):
        clock[0] += 90.0 if step == 1 else 1.0  # the first one compiles
        line.step(step, 200, 12345.0)
    assert len(lines) == 100
    assert "100 of 200" in lines[-1] and "best value 12,345" in lines[-1]
    assert "at most 1 min 40 s left" in lines[-1] and lines[-1].count("█") == 10


def test_it_is_quiet_where_no_one_looks(monkeypatch):
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    for wanted in (None, False):
        with shown(wanted) as line:
            line.tell("training")
            line.step(1, 2, 0.0)
    assert not sys.stderr.getvalue()
    monkeypatch.setattr(sys, "stderr", None)
    with shown(None) as line:
        line.tell("training")


@pytest.mark.parametrize("wanted", [None, True])
def test_a_terminal_has_one_line_that_goes_away(wanted, monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    with shown(wanted) as line:
        line.tell("training: compiling")
    text = sys.stderr.getvalue()
    assert text.startswith("\r") and "training: compiling" in text
    assert text.endswith("\r\x1b[K") and "\n" not in text
