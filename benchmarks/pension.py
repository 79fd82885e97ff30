"""All sensitivities of a fund by one adjoint pass, against bumping every input one after another.

    python -m benchmarks.pension [small medium large]

Same engine, same paths, both compiled. A bump is one-sided, prepare and a forward sweep, so that
n inputs take n + 1 of them; where there are more than `SAMPLE`, that many random ones are timed
and stand for all. The native engine has no batches of schedules: bumps run one by one.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

import snapo.domains.pension as domain
from snapo.adjoint import float64, prepare, pull_back
from snapo.domains.pension.case import read_case
from snapo.domains.pension.run import Problem, make_problem
from snapo.engine import Engine
from snapo.engine.native import Native
from snapo.scenarios import Pseudo
from snapo.smooth import Exact

from .gas_storage import timed

SIZES = ("small", "medium", "large")
PATHS, RUNS, SAMPLE, BUMP = 1024, 3, 100, 1e-6
OUTPUT = "funding_ratio"


def passes(problem: Problem, engine: Engine) -> tuple[Callable, Callable]:
    """The value at given inputs, and all its derivatives."""
    simulator, policy = problem.simulator, problem.policy
    draws = Pseudo(1).draws(np.arange(PATHS), simulator)
    weights = {OUTPUT: np.full(PATHS, 1 / PATHS)}

    def value(inputs) -> float:
        schedule = prepare(simulator, inputs)
        totals = float64(engine.values(simulator, policy, schedule, draws, Exact()).totals)
        return float(totals[OUTPUT].mean())

    def gradient() -> dict[str, np.ndarray]:
        schedule = prepare(simulator, problem.inputs)
        wrt = ("schedule",)
        found = engine.adjoint(simulator, policy, schedule, draws, Exact(), weights, wrt=wrt)
        return pull_back(simulator, problem.inputs, [found.schedule])

    return value, gradient


def bumped(problem: Problem, count: int) -> list[dict]:
    """Inputs with one entry moved, `count` of them drawn at random."""
    entries = [(n, k) for n, entry in problem.inputs.items() for k in range(entry.value.size)]
    chosen = np.random.default_rng(0).permutation(len(entries))[:count]
    moved = []
    for name, k in (entries[i] for i in chosen):
        array = np.array(problem.inputs[name].value)
        array.flat[k] += BUMP * max(1.0, abs(array.flat[k]))
        moved.append(problem.inputs | {name: replace(problem.inputs[name], value=array)})
    return moved


def row(size: str, engine: Engine) -> str:
    """One line: value, bumps, adjoint, and what the adjoint saves."""
    case = read_case(Path(domain.__path__[0]) / f"template_{size}")
    problem = make_problem(case, 0, "native")
    count = sum(entry.value.size for entry in problem.inputs.values())
    value, gradient = passes(problem, engine)
    value(problem.inputs), gradient()
    moved = bumped(problem, min(count, SAMPLE))
    values, gradients, bumps = [], [], []
    for some in np.array_split(np.arange(len(moved)), RUNS):
        gradients.append(timed(gradient))
        values.append(timed(lambda: value(problem.inputs)))
        bumps += [timed(lambda inputs=moved[i]: value(inputs)) for i in some]
    one, adjoint, bump = median(values), median(gradients), median(bumps)
    return (
        f"{size:<8}{count:>7}{case.steps:>7}{one:>10.3f}s{adjoint:>10.3f}s{adjoint / one:>8.2f}"
        f"{(count + 1) * bump:>11.1f}s{(count + 1) * bump / adjoint:>9.0f}"
    )


def table(sizes=SIZES) -> Iterator[str]:
    """The lines of the table, each as soon as it is known."""
    yield f"{PATHS} paths in float64, native engine; needed are 8, 80 and 500 times the speed"
    yield (
        f"{'fund':<8}{'inputs':>7}{'steps':>7}{'value':>11}{'adjoint':>11}{'ratio':>8}"
        f"{'all bumps':>12}{'speed-up':>9}"
    )
    for size in sizes:
        yield row(size, Native("float64"))


if __name__ == "__main__":
    for line in table(sys.argv[1:] or SIZES):
        print(line, flush=True)
