"""Dependence of results on cells along a length and over sizes: values on twice as many."""

from dataclasses import dataclass, replace

import numpy as np

from snapo.study.chapter import Number

from ..flowsheet.process import Process
from ..quality.records import Attribute

SMALL = 0.02  # of its value that an attribute without limits may move


@dataclass(frozen=True)
class Cells:
    """One attribute in its unit: `value` by the case's cells, `finer` by twice as many, and the
    change between them in margins of the attribute (`margins`), without limits in 2 % of its value;
    infinite where there is no number; `passed`: whether that is at most one."""

    attribute: str
    value: Number
    finer: Number
    margins: Number
    passed: bool


def finer_cells(process: Process) -> Process | None:
    """The process on twice as many cells, with as many time steps more; None without any cells."""
    case = process.case
    units = tuple(unit.finer() for unit in case.units)
    if all(new is old for new, old in zip(units, case.units)):
        return None
    # Steps of stiff units were chosen for other cells, so they are chosen again.
    numerics = replace(case.numerics, steps=2 * case.numerics.steps, held={})
    return Process(replace(case, units=units, numerics=numerics))


def on_finer_cells(process: Process, inputs=None) -> tuple[Cells, ...]:
    """Every attribute; () where no unit has cells."""
    finer = finer_cells(process)
    if finer is None:
        return ()
    rows = []
    for attribute, old, new in zip(
        process.case.attributes, process.values(inputs), finer.values(inputs)
    ):
        change = float(abs(new - old) / allowed(attribute, old))
        change = change if np.isfinite(change) else np.inf
        rows.append(Cells(attribute.name, float(old), float(new), change, change <= 1.0))
    return tuple(rows)


def allowed(attribute: Attribute, value: float) -> float:
    """The allowed change of an attribute with the cells."""
    limited = attribute.low is not None or attribute.high is not None
    return attribute.margin if limited or value == 0 else SMALL * abs(value)
