"""`snapo bench`: the speed of this machine for the gas storage template, value only and with
gradients."""

import time
from importlib.resources import files
from pathlib import Path

import jax
import numpy as np

from snapo.case.load import load
from snapo.engine import Native, Xla
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth
from snapo.study.study import ProgressCallback

from .read.case import read_case
from .setup import OUTPUT, make_setup

PATHS, ROUNDS = 1024, 5


def bench(engine: str, progress: ProgressCallback) -> str:
    """A table of medians in milliseconds, from alternating runs; with `engine` "auto" both engines
    are timed."""
    case = read_case(*load(Path(str(files(__package__ or "") / "template"))))
    setup = make_setup(case)
    problem, smooth = setup.problem, Smooth(np.float32(0.01))
    draws = Pseudo(1).draws(np.arange(PATHS), problem.simulator)
    weights = {OUTPUT: np.full(PATHS, 1 / PATHS)}
    values = (setup.policy, draws, smooth)
    engines = {"native": Native("float32"), "xla": Xla("float32")}
    jobs = {}
    for name, item in engines.items():
        if engine in ("auto", name):
            bound = item.bind(problem)
            jobs[name, "value"] = lambda bound=bound: bound.values(*values).totals
            jobs[name, "value and gradients"] = lambda bound=bound: bound.adjoint(*values, weights)
    for (name, message), job in jobs.items():
        progress(f"compiling {name}, {message}")
        jax.block_until_ready(job())
    seconds = {job: [] for job in jobs}
    for _ in range(ROUNDS):
        for key, job in jobs.items():
            started = time.perf_counter()
            jax.block_until_ready(job())
            seconds[key].append(time.perf_counter() - started)
    lines = [f"{problem.simulator.horizon} days, {PATHS} paths, float32, median of {ROUNDS}"]
    for (name, message), taken in seconds.items():
        lines.append(f"{name:<8}{message:<22}{1000 * np.median(taken):>10.1f} ms")
    return "\n".join(lines)
