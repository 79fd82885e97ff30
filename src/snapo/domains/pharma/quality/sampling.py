"""The mesh for statistics: thousands of batches need not be solved to ten digits."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..flowsheet.process import PharmaProcess
from . import batches

COARSER, ENOUGH = 4, 0.01  # times larger steps, where attributes move by less than this in margins


def on_steps(process: PharmaProcess, steps: int) -> PharmaProcess:
    """The same process with this number of steps per piece."""
    case = process.case
    if steps == case.numerics.steps:
        return process
    result = PharmaProcess(replace(case, numerics=replace(case.numerics, steps=steps)))
    result.inputs = process.inputs
    return result


def sampler(
    process: PharmaProcess, made: Callable[[PharmaProcess, int], PharmaProcess] | None = None
) -> tuple[PharmaProcess, dict[str, Any]]:
    """The process for statistics, and the loss of accuracy on its mesh. `made`: makes the same
    process on other steps, by default `on_steps`.

    The process on a quarter of the steps, if the nominal attributes then move by at most 1 % of
    their margins; the process itself if they move by more, or if it has no mesh.
    """
    case = process.case
    steps = max(8, case.numerics.steps // COARSER)
    if case.numerics.method == "mesh" and steps < case.numerics.steps:
        coarse = (made or on_steps)(process, steps)
        moved = np.subtract(
            *(
                batches.attributes(item, batches.nominally(item, {}))[0]
                for item in (coarse, process)
            )
        )
        gap = float(np.max(np.abs(moved) / [attribute.margin for attribute in case.attributes]))
        if gap <= ENOUGH:
            return coarse, {"steps": steps, "gap": gap}
    return process, {"steps": case.numerics.steps, "gap": 0.0}
