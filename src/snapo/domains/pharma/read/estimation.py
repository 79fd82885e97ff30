"""Reads `[estimation]`: the numbers to fit, and experiments with their measured data."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.case.csv import FileReference, Row, read_rows
from snapo.case.error import CaseError
from snapo.case.quantity import Range
from snapo.case.table import TableContext, parse

from ..flowsheet.possible import smallest
from ..given import Entry
from ..quality.records import Estimation, Experiment
from ..time.dynamics import LATE
from ..units.operation import Unit
from .entries import EntryNumbers
from .numbers import ANY, NOT_NEGATIVE, POSITIVE, quantity, suggest, unit_of
from .quantities import conversion, own_basis
from .tables import EstimationTable, ExperimentTable, FitTable

NOISE = 5.0  # standard deviations that the noise of a measurement may take it below 0
COLUMNS = ("time", "state", "value", "error")


def read_estimation(
    file, raw: dict | None, numbers: EntryNumbers, species, units: Sequence[Unit], notes
) -> Estimation | None:
    """The numbers that are fitted, their bounds, and the experiments to which they are fitted."""
    if raw is None:
        return None
    table = parse(EstimationTable, raw, str(file), "estimation")
    which, lows, highs, logarithms, local, scales = [], [], [], [], [], []
    for i, item in enumerate(table.fit):
        section = TableContext(file, f"estimation.fit[{i}]", notes)
        fit = parse(FitTable, item, str(file), section.name)
        entry = numbers.one(section, "of", fit.of)
        if entry in which:
            raise section.error("of", fit.of, "this number appears twice")
        unit = numbers.unit(*entry)
        low, high = (
            quantity(section, key, raw, unit, basis=own_basis(entry[0]))
            for key, raw in (("low", fit.low), ("high", fit.high))
        )
        if not low < high:
            raise section.error("high", fit.high, "high must be above low")
        numbers.check(section, "low", fit.low, entry, low)
        numbers.check(section, "high", fit.high, entry, high)
        if fit.logarithm and low <= 0:
            raise section.error("low", fit.low, "a logarithm needs bounds above 0")
        start = numbers.value(entry)
        if not low < start < high:
            message = f"the value in the case, {start:g} {unit}, must lie between low and high"
            raise section.error("low", fit.low, message)
        which.append(entry)
        lows.append(low)
        highs.append(high)
        logarithms.append(fit.logarithm)
        local.append(unit_of(section, "low", fit.low, unit))
        scales.append(_scale(local[-1], unit))
    available = {
        f"{u.name}.{state}": unit for u in units for state, unit in u.states(species).items()
    }
    endpoints = {u.name: (u.time.name, 0) for u in units if u.time is not None}
    least_fitted = dict(zip(which, lows))
    experiments = tuple(
        _experiment(file, experiment, i, numbers, available, endpoints, least_fitted, notes)
        for i, experiment in enumerate(table.experiments)
    )
    apart = [bool(value.get("held_out", False)) for value in table.experiments]
    resolved, held_out = (
        tuple(each for each, out in zip(experiments, apart) if out == requested)
        for requested in (False, True)
    )
    measured = sum(len(each.time) for each in resolved)
    if measured <= len(which):
        section = TableContext(file, "estimation", notes)
        message = f"{measured} measurements are too few to fit {len(which)} numbers"
        raise section.error("experiments", None, message)
    return Estimation(
        tuple(name for name, _ in which), tuple(entry for _, entry in which), tuple(logarithms),
        tuple(lows), tuple(highs), resolved, table.level, tuple(local), tuple(scales), held_out,
        table.errors, table.starts,
    )  # fmt: skip


def _experiment(
    file, raw, i: int, numbers: EntryNumbers, available, endpoints: dict[str, Entry], fit, notes
) -> Experiment:
    """`available`: {state: unit}; `endpoints`: the key of a unit's duration; `fit`: {number:
    its lower bound}."""
    section = TableContext(file, f"estimation.experiments[{i}]", notes)
    table = parse(ExperimentTable, raw, str(file), section.name)
    settings = []
    for text, inputs in table.settings.items():
        entry = numbers.one(section, f"settings.{text}", text)
        unit, key = numbers.unit(*entry), f"settings.{text}"
        value = quantity(section, key, inputs, unit, basis=own_basis(entry[0]))
        numbers.check(section, f"settings.{text}", inputs, entry, value)
        settings.append((*entry, value))
    rows = read_rows(FileReference(section, "data", table.data), COLUMNS)
    times = np.array([_cell(row, "time", "s") for row in rows])
    names = []
    for row in rows:
        state = row.cells["state"]
        if state not in available:
            hint = suggest(state, available, "state")
            raise row.error("state", f"there is no such state; {hint}")
        names.append(state)
    local = {(name, entry): value for name, entry, value in settings}
    for row, time, state in zip(rows, times, names):
        unit = state.partition(".")[0]
        end = fit.get(endpoints[unit], local.get(endpoints[unit], numbers.value(endpoints[unit])))
        if time > end * (1 + LATE):
            message = (
                f"{unit} ends at {end:.10g} s in this experiment, and after that there is nothing "
                f"to compare with; for a longer batch set {endpoints[unit][0]} in its `settings`"
            )
            raise row.error("time", message)
    values = np.array([_cell(row, "value", available[row.cells["state"]], ANY) for row in rows])
    errors = np.array(
        [_cell(row, "error", available[row.cells["state"]], POSITIVE) for row in rows]
    )
    for row, value, error in zip(rows, values, errors):
        lowest = smallest(row.cells["state"])
        if value < lowest - NOISE * error:
            message = (
                f"the value is {(lowest - value) / error:.3g} of its standard deviations below the "
                f"smallest possible value; at most {NOISE:g} are allowed"
            )
            raise row.error("value", message)
    metadata = [
        unit_of(_Cell(row, "value"), "value", row.cells["value"], available[state])
        for row, state in zip(rows, names)
    ]
    scales = tuple(_scale(unit, available[state]) for unit, state in zip(metadata, names))
    return Experiment(
        table.name, tuple(settings), times, tuple(names), values, errors, tuple(metadata), scales
    )


def _scale(local: str, unit: str) -> tuple[float, float]:
    change = conversion(local, unit)
    return change.scale, change.offset


def _cell(row: Row, column: str, unit: str, bounds: Range = NOT_NEGATIVE) -> float:
    """A quantity in a cell, "600 s"; mistakes name the line."""
    cell, error, local = _Cell(row, column), column == "error", own_basis(row.cells["state"])
    return quantity(cell, column, row.cells[column], unit, bounds, error, local)


class _Cell(NamedTuple):
    """A cell as the place of a mistake."""

    row: Row
    column: str

    def error(self, key: str, value: Any, allowed: str) -> CaseError:
        return self.row.error(self.column, allowed)
