"""Vega by parameter and delivery month: the derivative with respect to the volatility of a month.

The volatility s(d) of a delivery day d is the volatility of its spot price in the price model,

    S(d) = F(d) exp(s(d) f(d) - s(d)^2 var f(d) / 2)

and the volatilities of all other days do not change. The vega of a month is the sum, over its days,
of the derivatives with respect to s(d). The sum over all months is therefore the derivative with
respect to a volatility of all days.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import jax
import numpy as np

from snapo.problem.form import Use
from snapo.problem.problem import Problem
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Table, Text
from snapo.report.quantity import decimals, long_month, number, plus_minus
from snapo.solver.sensitivity import sensitivities
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..setup import case_of

GROUP = "volatility"  # of the inputs that are volatilities
FILE = "vega.csv"
TEXT = (
    "Change of the value if the volatility of all prices delivered in a month rises by one, in the "
    "unit of the column, while the volatility of other months and the decisions stay the same. "
    "If a factor moves all prices, only its effect on the prices of this month changes. The sum "
    "over the months "
    "is the derivative with respect to the volatility of all days. The interval contains the "
    "sampling error only; the table of sensitivities has the sum with an interval that also "
    "contains the error of the policy."
)


@dataclass(frozen=True)
class MonthVega:
    """The vega of a delivery month.

    - `parameter`: the input; `factor`: its number if there are several, else 0.
    - `month`: "2021-04", or "" for all months; `volatility`: the mean over its days.
    - `vega`, `standard_error`: the derivative with the decisions held fixed, per `unit` of the
      volatility, and its error.
    - `points`: the number of volatility points, or other units of a report, in one `unit`; `point`:
      the name of these units.
    """

    parameter: str
    factor: int
    month: str
    volatility: Number = np.nan
    vega: Number = np.nan
    standard_error: Number = np.nan
    unit: str = ""
    points: Number = 1.0
    point: str = ""


@dataclass(frozen=True)
class Vegas:
    """The vegas by parameter and month; the last entry of each parameter is the sum over its
    months."""

    vega_by_month: tuple[MonthVega, ...] = ()


def volatilities(problem: Problem) -> list[str]:
    """The names of the inputs that are volatilities; supplied paths have none."""
    return [name for name, x in problem.inputs_by_name.items() if x.group == GROUP and x.value.size]


def vega_by_month(run: StudyRun, dates: Sequence[date]) -> Vegas:
    """The vega of a run with prices on `dates`, one date more than decisions; writes vega.csv."""
    setup, policy = run.setup, run.solution.policy
    table = run.solution.sensitivities
    problem = setup.problem
    names = volatilities(problem)
    if table is None or policy is None or not names:
        return Vegas()
    months = np.array([day.strftime("%Y-%m") for day in dates])
    wide = by_date(problem, names, len(dates))
    if table.of_inputs is not None:
        held = table.of_inputs(wide)
    else:
        paths = setup.evaluation.within(problem.simulator.horizon).sensitivity_paths
        held = sensitivities(wide, policy, paths=paths, engine=setup.engines.evaluate).held
    # The end date has a price only where gas left is paid by it.
    last = [held[name].value.reshape(len(dates), -1)[-1] for name in names]
    priced, rows = months if np.any(np.concatenate(last)) else months[:-1], []
    for name in names:
        values = wide.inputs_by_name[name].value.reshape(len(dates), -1)
        about, count = problem.inputs_by_name[name], values.shape[1]
        for factor in range(count):
            for month in (*dict.fromkeys(priced), ""):
                selected = months == month if month else np.ones(len(months), bool)
                along = np.zeros(values.shape)
                along[selected, factor] = 1.0
                vega = held[name].along(along.ravel())
                mean = float(f"{values[selected, factor].mean():.12g}")  # rounding of a sum
                units = about.unit, about.display_factor, about.display_unit or about.unit
                rows.append(
                    MonthVega(name, factor + 1 if count > 1 else 0, month, mean, *vega, *units)
                )
    run.write_records(FILE, MonthVega, rows)
    return Vegas(tuple(rows))


def by_date(problem: Problem, names: Sequence[str], count: int) -> Problem:
    """The problem with only these inputs, each of which has a separate number for each of `count`
    dates. A number that is used on several dates becomes one number of the same value for each date
    (and for each factor, if there are several).
    """
    values = {name: entry.value for name, entry in problem.inputs_by_name.items()}
    wide: dict[str, np.ndarray] = {}

    def spread(leaf: Any) -> Any:
        if not isinstance(leaf, Use) or leaf.name not in names:
            return leaf
        shape = leaf.shape or (count,)
        wide[leaf.name] = np.broadcast_to(leaf.in_numpy(values), shape).ravel()
        numbers = wide[leaf.name].size
        return Use.of(leaf.name, numbers, np.arange(numbers).reshape(shape))

    simulator = jax.tree.map(spread, problem.simulator, is_leaf=lambda x: isinstance(x, Use))
    inputs: Any = dict(values)
    for name, numbers in wide.items():
        labels = tuple(map(str, range(numbers.size)))
        inputs[name] = replace(problem.inputs_by_name[name], value=numbers, labels=labels)
    return replace(problem, simulator=simulator, inputs=inputs)


def measure(run: StudyRun) -> Vegas:
    """The vega of a store."""
    case = case_of(run.setup)
    return vega_by_month(run, (*case.days, case.end))


def show(run: RunFiles, result: Vegas) -> Sequence[Block]:
    """A table with a row for each month and columns for each volatility."""
    rows = result.vega_by_month
    if not rows:
        return [why_missing(run, VEGA.name)]
    columns = {key: [x for x in rows if (x.parameter, x.factor) == key]
               for key in dict.fromkeys((x.parameter, x.factor) for x in rows)}  # fmt: skip
    head, digits = [("Delivery", "")], decimals([x.vega / x.points for x in rows], 5)
    for (name, factor), column in columns.items():
        title = name.replace("_", " ").capitalize() + (f", factor {factor}" if factor else "")
        per = f"{run.unit} per {column[0].point}".strip()
        head += [(title, column[0].unit), ("Vega", per), ("", "")]
    cells = []
    for line in zip(*columns.values(), strict=True):
        row = [long_month(line[0].month) if line[0].month else "All months"]
        for x in line:
            level = decimals([y.volatility for y in columns[x.parameter, x.factor]], 4)
            row += [number(x.volatility, level), number(x.vega / x.points, digits),
                    plus_minus(x.standard_error / x.points, digits)]  # fmt: skip
        cells.append(tuple(row))
    return [Text(TEXT), Table(head, cells, texts=1, strong=frozenset([len(cells) - 1]))]


VEGA = Chapter("vega", "Vega by delivery month", Vegas, measure, show, "Vega", optional=True)
