"""Tests whether results depend on the grid: values and gradients with finer time steps and with
error control, and values with twice as many cells along a length and over sizes.
"""

from dataclasses import dataclass, replace

import numpy as np

from snapo.study.chapter import Number

from ..flowsheet.process import PharmaProcess
from ..quality import batches
from ..quality.records import Attribute
from .certify import STEP
from .jacobian import Jacobian, matrix

SMALL = 0.02  # of its value that an attribute without limits may move


@dataclass(frozen=True)
class Cells:
    """One attribute in its unit: `value` with the case's cells, `finer` with twice as many;
    `margins`: the change between them in margins of the attribute, or in 2 % of the value if it has
    no limits; infinite if there is no number. `passed`: whether the change is at most one
    margin."""

    attribute: str
    value: Number
    finer: Number
    margins: Number
    passed: bool


def finer_cells(process: PharmaProcess) -> PharmaProcess | None:
    """The process with twice the number of cells and of time steps; None without any cells."""
    case = process.case
    units = tuple(unit.finer() for unit in case.units)
    if all(new is old for new, old in zip(units, case.units)):
        return None
    # Steps of stiff units were chosen for other cells, so they are chosen again.
    numerics = replace(case.numerics, steps=2 * case.numerics.steps, held={})
    return PharmaProcess(replace(case, units=units, numerics=numerics))


def on_finer_cells(process: PharmaProcess, inputs=None) -> tuple[Cells, ...]:
    """The test of every attribute; () if no unit has cells."""
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
    """The change of an attribute with the number of cells that is allowed."""
    limited = attribute.low is not None or attribute.high is not None
    return attribute.margin if limited or value == 0 else SMALL * abs(value)


VALUES, DERIVATIVES = 1e-6, 1e-5  # gaps that count as agreement


@dataclass(frozen=True)
class ConvergenceRow:
    """One number that is tested: a value (with "value" as `parameter`) or a derivative.

    `mesh`: by the case's method; `finer`: with twice its steps or a tenth of its tolerance;
    `adaptive`: error-controlled (equal to `finer` if the case is error-controlled). The gap of a
    value is relative to this value, and the gap of a derivative to the largest derivative of the
    attribute. The scale is at least the attribute's margin or, for a derivative, the margin per
    half of the normal range.
    """

    attribute: str
    parameter: str
    mesh: Number
    finer: Number
    adaptive: Number
    halving_gap: Number
    adaptive_gap: Number


@dataclass(frozen=True)
class Convergence:
    """`passed`: whether values agree to 1e-6 and derivatives to 1e-5; `cells`: attributes on twice
    as many cells along lengths and over sizes, if there are any."""

    rows: tuple[ConvergenceRow, ...]
    passed: bool
    cells: tuple[Cells, ...] = ()


def _own(process: PharmaProcess, inputs) -> Jacobian:
    """The parameters' columns of the matrix of a run, whose function is compiled only once."""
    entries = batches.varied(process.case)
    result = matrix(process, inputs, entries=entries)
    columns = [entries.index(entry) for entry in process.entries]
    return result._replace(jacobian=result.jacobian[:, columns])


def _differences(process: PharmaProcess, inputs) -> Jacobian:
    """Derivatives with respect to the parameters, as central differences of fourth order of single
    runs."""
    parameters = process.case.parameters
    here, values = process.at(process.entries, inputs), process.nominal_inputs(inputs)
    columns = []
    for i, parameter in enumerate(parameters):
        step = STEP * (parameter.normal_high - parameter.normal_low) / 2
        far_low, low, high, far_high = (
            process.values(
                batches.inputs_with(process, {process.entries[i]: here[i] + k * step}, values)
            )
            for k in (-2, -1, 1, 2)
        )
        columns.append((8 * (high - low) - (far_high - far_low)) / (12 * step))
    reason = "differences of the error-controlled solution"
    runs = 4 * len(parameters)
    return Jacobian(process.values(inputs), np.stack(columns, 1), "forward", reason, runs)


def convergence(process: PharmaProcess, inputs=None, tolerance: float = 1e-10) -> Convergence:
    """Every attribute and its derivative with respect to every parameter, by three methods; that of
    the case is tested.

    `tolerance` is that of the adaptive solution, or the case's if that is tighter. If units hold
    their steps, the derivatives of the adaptive solution are differences of its values: through an
    implicit solver with error control the adjoint takes minutes to compile.
    """
    numerics = process.case.numerics
    tight = min(tolerance, numerics.tolerance)
    ways = [numerics, numerics.finer()]
    if numerics.method == "mesh":
        ways.append(replace(numerics, method="adaptive", tolerance=tight))
    tables = []
    for path in ways:
        other = PharmaProcess(replace(process.case, numerics=path))
        if path == numerics:
            differences = _own(process, inputs)
        elif path.method == "adaptive" and numerics.held:
            differences = _differences(other, inputs)
        else:
            differences = matrix(other, inputs)
        tables.append(np.concatenate([differences.values[:, None], differences.jacobian], 1))
    rows, passed = [], True
    case = process.case
    half = np.array([(item.normal_high - item.normal_low) / 2 for item in case.parameters])
    for q, attribute in enumerate(case.attributes):
        largest = np.max(np.abs(tables[0][q, 1:]), initial=0.0)
        # What is next to nothing is compared with a margin, and its slope with one in half a range.
        floors = attribute.margin / np.append(1.0, half)
        for p, parameter in enumerate(("value", *process.parameters)):
            mesh, finer, adaptive = (float(tables[i][q, p]) for i in (0, 1, -1))
            scale = max(abs(mesh) if p == 0 else largest, float(floors[p]))
            gaps = [abs(other - mesh) / scale for other in (finer, adaptive)]
            rows.append(ConvergenceRow(attribute.name, parameter, mesh, finer, adaptive, *gaps))
            passed &= max(gaps) <= (DERIVATIVES if p else VALUES)
    return Convergence(tuple(rows), bool(passed))
