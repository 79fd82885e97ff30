"""`snapo bench`: how fast this machine runs the flagship, value alone and with gradients."""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from snapo.engine import Native, Xla
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Smooth

from .case import read_case
from .problem import make_problem, new_policy

PATHS, ROUNDS = 1024, 5
OUTPUT = "cash_flow"


def bench(engine: str, progress: Callable[[str], None]) -> str:
    """A table of medians in milliseconds, from alternating runs; `engine` "auto" times both."""
    problem = make_problem(read_case(Path(__file__).parent / "template"), seed=0)
    policy, smooth = new_policy(problem), Smooth(np.float32(0.01))
    draws = Pseudo(1).draws(np.arange(PATHS), problem.simulator)
    weights = {OUTPUT: np.full(PATHS, 1 / PATHS)}
    given = (problem.simulator, policy, problem.schedule, draws, smooth)
    engines = {"native": Native("float32"), "xla": Xla("float32")}
    jobs = {}
    for name, each in engines.items():
        if engine in ("auto", name):
            jobs[name, "value"] = lambda each=each: each.values(*given).totals
            jobs[name, "value and gradients"] = lambda each=each: each.adjoint(*given, weights)
    for (name, what), job in jobs.items():
        progress(f"compiling {name}, {what}")
        jax.block_until_ready(job())
    seconds = {job: [] for job in jobs}
    for _ in range(ROUNDS):
        for key, job in jobs.items():
            started = time.perf_counter()
            jax.block_until_ready(job())
            seconds[key].append(time.perf_counter() - started)
    lines = [f"{problem.simulator.horizon} days, {PATHS} paths, float32, median of {ROUNDS}"]
    for (name, what), taken in seconds.items():
        lines.append(f"{name:<8}{what:<22}{1000 * np.median(taken):>10.1f} ms")
    return "\n".join(lines)
