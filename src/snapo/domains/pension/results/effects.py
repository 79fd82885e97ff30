"""Derivatives as effects of the moves that an actuary makes: rows of the report's tables."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.inputs import Input, plain
from snapo.solver.sensitivity import Sensitivities
from snapo.solver.solution import Solution
from snapo.study.chapters.sensitivities import interval
from snapo.study.study import Setup, StudyRun

from ..people.longer_life import longer_life
from .compare import equivalent
from .setup import case_in

OF_ITSELF = 0.01  # the move of a quantity, as a share of itself
LIFE = (
    "all death rates fall in proportion, by sex, until the expectation of life at 65 is a year"
    " longer; to first order"
)


class Move(NamedTuple):
    """How far each number of an input is moved [n], and the words."""

    size: np.ndarray
    words: str


def move(entry: Input) -> Move:
    """The usual move of an input's numbers; rises are positive."""
    values = entry.value.ravel()
    if entry.move is not None:
        amount = f"{entry.move * entry.trade_factor:g} {entry.trade_unit}".strip()
        return Move(np.full(values.size, entry.move), amount)
    if not values.any():
        # There is no per cent of nothing.
        return Move(np.ones(values.size), "1 unit")
    return Move(OF_ITSELF * values, f"{OF_ITSELF * 100:g} % of itself")


def work(run: StudyRun) -> dict[str, Any]:
    """ "sensitivities": effects of the usual moves on the objective (see `effects`)."""
    return {"sensitivities": effects(run.setup, run.solution)}


def effects(setup: Setup, solution: Solution) -> dict[str, Any]:
    """Effects of the usual moves on the objective: each number alone, and all of an input's.

    With a utility of a ratio (`compare.equivalent`) the effects are on the certainty equivalent
    (`unit` is "ratio"). `effect`, `low`, `high`: with the reported derivative, see
    `study.parts.moves`; `held` with its `standard_error` holds the decisions, `reacting` lets the
    trained policy react.
    `combined` are moves across the numbers of an input: a year of life.
    """
    problem = setup.problem
    table = solution.sensitivities
    if table is None:
        return {}
    known = equivalent(problem.objective, solution.value)
    slope = 1.0 if known is None else known.slope
    families, rows = [], []
    for name, given in table.inputs.items():
        usual = move(given)
        family = {"input": name, "count": given.value.size, "move": usual.words}
        family |= {"group": given.group, "words": given.words}
        families.append(family | _along(table, name, usual.size, slope))
        for i, label in enumerate(given.names()):
            alone = np.zeros(given.value.size)
            alone[i] = usual.size[i]
            row = {"input": name, "label": label, "move": usual.words}
            row["group"] = given.group
            rows.append(row | _along(table, name, alone, slope))
    combined = []
    if (life := longer_life(case_in(setup), plain(problem.inputs))) is not None:
        row = {"input": "year_of_life", "count": len(life.change), "move": "1 year"}
        row |= {"group": "people", "words": LIFE}
        combined.append(row | _along(table, life.input, life.change, slope))
    unit = "objective" if known is None else "ratio"
    return {"unit": unit, "families": families, "combined": combined, "rows": rows}


def _along(table: Sensitivities, name: str, move: np.ndarray, slope: float) -> dict[str, Any]:
    """The effect of a move [n] of an input's numbers, with its interval."""
    move = move.reshape(table.inputs[name].value.shape)
    derivative = interval(table, name, move)
    found: dict[str, Any] = {key: None if x is None else slope * x for key, x in derivative.items()}
    held, error = table.held[name].along(move)
    found |= {"source": table.source(name), "held": slope * held, "standard_error": slope * error}
    if table.smooth is not None:
        found["reacting"] = slope * table.smooth[name].along(move)[0]
    return found
