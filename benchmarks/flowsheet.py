"""The best recipe of a flowsheet by exact derivatives, compared with Nelder and Mead's method.

    python -m benchmarks.flowsheet [CASE]

The case is `examples/plug_flow`: plug-flow reactor, tank, batch crystalliser, filter; six
decisions, three of them temperatures. The problem is that of the optimisation tutorial of PharmaPy,
in which Nelder and Mead's method took 543 s for 400 evaluations and ended without convergence. Here
both methods search the same compiled flowsheet; Nelder and Mead's method takes the constraints as a
quadratic penalty, as in that tutorial.
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from scipy.optimize import minimize

from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import read_case
from snapo.domains.pharma.recipe.optimise import Optimum, goal_and_room, optimise

EXAMPLE = Path(__file__).parents[1] / "examples" / "plug_flow"
EVALUATIONS, PENALTY = 400, 100.0


def nelder_mead(process: PharmaProcess, found: Optimum) -> tuple[float, float, int, float, bool]:
    """Objective and largest violation at the end, evaluations, seconds, whether it converged."""
    ask = process.case.optimise
    assert ask is not None
    call = jax.jit(goal_and_room(process, found.bounds, found.ramps))
    low, high, start = (
        np.array([getattr(each, key) for each in ask.decisions]) for key in ("low", "high", "start")
    )

    def at(u: np.ndarray) -> np.ndarray:
        with jax.enable_x64(True):
            return np.asarray(call(low + (high - low) * u))

    def penalised(u: np.ndarray) -> float:
        goal, *room = at(u)
        return -ask.sense * goal / abs(found.before) + PENALTY * sum(min(0.0, x) ** 2 for x in room)

    first = (start - low) / (high - low)
    at(first)  # compiles
    started = time.perf_counter()
    ended = minimize(
        penalised, first, method="Nelder-Mead", bounds=[(0.0, 1.0)] * len(first),
        options={"maxfev": EVALUATIONS},
    )  # fmt: skip
    spent = time.perf_counter() - started
    goal, *room = at(ended.x)
    return float(goal), float(-min(0.0, *room)), int(ended.nfev), spent, bool(ended.success)


def table(case=EXAMPLE) -> Iterator[str]:
    """The lines of the table, each as soon as it is known."""
    process = PharmaProcess(read_case(case))
    started, processor = time.perf_counter(), time.process_time()
    found = optimise(process)
    whole, processor = time.perf_counter() - started, time.process_time() - processor
    recipe, conditions = found.recipe, found.recipe.conditions
    ask = process.case.optimise
    assert ask is not None
    yield (
        f"{process.case.title}: {len(ask.decisions)} decisions, {len(found.bounds)} limits, "
        f"{2 * len(found.ramps)} ramps; required: an optimum that meets its conditions, in 10 s"
    )
    yield f"{'':<22}{'goal':>10}{'violation':>11}{'evaluations':>13}{'seconds':>9}  "
    yield f"{'start':<22}{found.before:>10.6f}"
    yield (
        f"{'exact derivatives':<22}{recipe.value:>10.6f}{conditions.violation:>11.1e}"
        f"{recipe.evaluations:>13}{found.solving:>9.2f}  and {found.compiling:.1f} to compile, "
        f"{whole:.1f} in all ({processor:.1f} of processors); {len(found.endpoints)} starts, "
        f"{recipe.iterations} iterations in the best"
    )
    yield f"{'':<22}{found.mode}"
    verdict = "converged" if recipe.converged else "NOT converged"
    yield f"{'':<22}{verdict}: relative stationarity {conditions.stationarity:.1e}"
    for each, x, below, above in zip(ask.decisions, recipe.x, conditions.low, conditions.high):
        side = "low" if below else "high" if above else ""
        worth = f"  at {side}, multiplier {(below + above) * each.scale:.3g}" if side else ""
        yield f"{'':<22}{each.name:<30}{each.in_case_unit(x):>10.4f} {each.unit}{worth}"
    for each, worth in zip(found.bounds, conditions.above):
        if worth:
            yield (
                f"{'':<22}{each.name} at its limit {each.limit:g} {each.unit}, "
                f"multiplier {worth / each.size:.3g}"
            )
    for i, each in enumerate(found.ramps):
        worth = conditions.above[len(found.bounds) + 2 * i :][:2].max()
        if worth:
            yield f"{'':<22}{each.name} at its largest slope, multiplier {worth:.3g}"
    goal, violation, count, spent, success = nelder_mead(process, found)
    yield (
        f"{'Nelder and Mead':<22}{goal:>10.6f}{violation:>11.1e}{count:>13}{spent:>9.2f}  "
        f"{'converged' if success else 'not converged'}"
    )


if __name__ == "__main__":
    for line in table(*map(Path, sys.argv[1:])):
        print(line, flush=True)
