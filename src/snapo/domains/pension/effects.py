"""Derivatives as effects of the moves that an actuary makes: rows of the report's tables."""

from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.problem.inputs import plain
from snapo.solver.sensitivity import Sensitivities
from snapo.solver.solution import Solution

from . import units
from .compare import equivalent
from .longer_life import longer_life

if TYPE_CHECKING:
    from .run import Problem


def effects(problem: "Problem", solution: Solution) -> dict[str, Any]:
    """Effects of the usual moves on the objective: each number alone, and all of an input's.

    With a utility of the funding ratio the effects are on the certainty equivalent (`unit` is
    "ratio"). `effect` holds the decisions, `reacting` lets the trained policy react. `combined`
    are moves across the numbers of an input: a year of life.
    """
    table = solution.sensitivities
    if table is None:
        return {}
    known = equivalent(problem.objective, solution.value)
    slope = 1.0 if known is None else known.slope
    families, rows = [], []
    for name, given in table.inputs.items():
        move = units.move(name, given)
        family = {"input": name, "count": given.value.size, "move": move.words}
        families.append(family | _along(table, name, move.size, slope))
        for i, label in enumerate(given.names()):
            alone = np.zeros(given.value.size)
            alone[i] = move.size[i]
            row = {"input": name, "label": label, "move": move.words}
            rows.append(row | _along(table, name, alone, slope))
    combined = []
    if (life := longer_life(problem.case, plain(problem.inputs))) is not None:
        row = {"input": "year_of_life", "count": len(life.change), "move": "1 year"}
        combined.append(row | _along(table, life.input, life.change, slope))
    unit = "objective" if known is None else "ratio"
    return {"unit": unit, "families": families, "combined": combined, "rows": rows}


def _along(table: Sensitivities, name: str, move: np.ndarray, slope: float) -> dict[str, float]:
    """The effect of a move [n] of an input's numbers, with its standard error."""
    move = move.reshape(table.inputs[name].value.shape)
    effect, error = table.held[name].along(move)
    found = {"effect": slope * effect, "standard_error": slope * error}
    if table.smooth is not None:
        found["reacting"] = slope * table.smooth[name].along(move)[0]
    return found
