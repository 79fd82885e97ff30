"""Computing times of a batch, of its derivatives and of many batches, for the template case."""

import time
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.study.study import ProgressCallback

from .derivatives.jacobian import gradient, matrix
from .flowsheet.process import PharmaProcess
from .quality.draws import all_draws, all_entries
from .read.case import resolve

BATCHES, REPEATS = 4096, 5


def bench(engine: str, progress: ProgressCallback) -> str:
    """A table of the first times, which include compilation, and of the best later times."""
    if engine not in ("auto", "xla", "native"):
        raise CaseError("--engine", "", engine, 'it must be "auto", "xla" or "native"')
    file = files("snapo.domains.pharma") / "template" / "case.toml"
    process = PharmaProcess(
        resolve(Path(str(file)), tomllib.loads(file.read_text(encoding="utf-8")))
    )
    case, name = process.case, process.names[0]
    draws = all_draws(case, BATCHES, case.training.seed)
    requested: Any = engine
    works: dict[str, Callable[[], Any]] = {
        "one batch, values": process.values,
        f"matrix, {len(process.names)} attributes by {len(process.parameters)} parameters": (
            lambda: matrix(process)
        ),
        "derivatives of one attribute, adjoint": lambda: gradient(process, name),
        f"{BATCHES} batches, values": (
            lambda: process.batch(all_entries(case), draws, engine=requested)
        ),
    }
    lines = [f"{'':<44} {'first, s':>9} {'best, ms':>9}"]
    for text, work in works.items():
        progress(text)
        first, best = _times(work)
        lines.append(f"{text:<44} {first:>9.2f} {1000 * best:>9.2f}")
    return "\n".join(lines)


def _times(work: Callable[[], Any]) -> tuple[float, float]:
    """Seconds of the first call, which compiles, and of the fastest further call."""
    seconds = []
    for _ in range(1 + REPEATS):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return seconds[0], min(seconds[1:])
