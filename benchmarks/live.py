"""The time in which the worker of the page of `snapo open` answers a move of an input.

    python -m benchmarks.live RUN [MOVES]

RUN is a solved run. The handles of its first input with many numbers (for a store, the forward
curve) are moved one after another. For every table of the page the median and the longest time
until it is computed are printed, and then the processor time of a move.
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from snapo.live.terms import handles, usual
from snapo.live.worker import open_run

MOVES = 50
SHOWN = ("value", "deltas", "today", "fans")


def table(run: Path, moves: int = MOVES) -> Iterator[str]:
    """The lines of the table."""
    started = time.perf_counter()
    valuation = open_run(run)
    dict(valuation.stages({}))
    yield f"ready after {time.perf_counter() - started:.1f} s; paths: {valuation.counts}"
    many = [each for each in valuation.inputs_by_name.items() if len(handles(each[1])) > 1]
    name, given = next((each for each in many if each[1].group in ("price", "curve")), many[0])
    found: dict[str, list[float]] = {}
    errors, busy = [], []
    for move in range(moves):
        at = handles(given)[move % len(handles(given))][1]
        moved = given.value.copy()
        moved.ravel()[at] += usual(given).ravel()[at] * (1 + move // len(handles(given)))
        started, processor = time.perf_counter(), time.process_time()
        for stage, numbers in valuation.stages({name: moved}):
            if stage == "value":
                errors.append(abs(numbers["standard_error"] / numbers["value"]))
            if stage in SHOWN:
                found.setdefault(stage, []).append(time.perf_counter() - started)
                spent = time.process_time() - processor
        busy.append(spent)
    yield f"{moves} moves of {name}; standard error at most {100 * max(errors):.3f} % of the value"
    for stage, seconds in found.items():
        yield f"{stage:<8} median {np.median(seconds):6.2f} s, worst {max(seconds):6.2f} s"
    yield f"processor time of a move: {np.median(busy):.2f} s"


if __name__ == "__main__":
    given = sys.argv[1:]
    for line in table(Path(given[0]), *map(int, given[1:2])):
        print(line, flush=True)
