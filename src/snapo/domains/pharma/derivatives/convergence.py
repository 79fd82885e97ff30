"""Does the answer depend on the mesh? Values and gradients on twice the mesh and adaptively."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..flowsheet.process import Process
from ..quality import batches
from .jacobian import Matrix, matrix

VALUES, DERIVATIVES = 1e-6, 1e-5  # gaps that count as agreement


class Row(NamedTuple):
    """One number of the answer: a value ("value" as `parameter`) or a derivative.

    `mesh`, `finer`, `adaptive`: by the case's steps, by twice as many, error-controlled; gaps
    are relative to the value, for a derivative to the largest in its attribute's row.
    """

    attribute: str
    parameter: str
    mesh: float
    finer: float
    adaptive: float
    halving_gap: float
    adaptive_gap: float


class Convergence(NamedTuple):
    """`passed`: whether values agree to 1e-6 and derivatives to 1e-5."""

    rows: tuple[Row, ...]
    passed: bool


def _own(process: Process, inputs) -> Matrix:
    """By the parameters, from the function that gives a run its matrix: it is compiled once."""
    entries = batches.varied(process.case)
    found = matrix(process, inputs, entries=entries)
    columns = [entries.index(each) for each in process.entries]
    return found._replace(jacobian=found.jacobian[:, columns])


def convergence(process: Process, inputs=None, tolerance: float = 1e-10) -> Convergence:
    """Every attribute and its derivative by every parameter, three ways.

    `tolerance` is that of the adaptive solution, or the case's if that is tighter.
    """
    numerics = process.case.numerics
    tight = min(tolerance, numerics.tolerance)
    ways = (
        replace(numerics, method="mesh"),
        numerics.finer(),
        replace(numerics, method="adaptive", tolerance=tight),
    )
    tables = []
    for way in ways:
        if way == numerics:
            found = _own(process, inputs)
        else:
            found = matrix(Process(replace(process.case, numerics=way)), inputs)
        tables.append(np.concatenate([found.values[:, None], found.jacobian], 1))
    rows, passed = [], True
    for q, name in enumerate(process.names):
        largest = np.max(np.abs(tables[0][q, 1:]), initial=0.0)
        for p, parameter in enumerate(("value", *process.parameters)):
            mesh, finer, adaptive = (float(table[q, p]) for table in tables)
            scale = abs(mesh) if p == 0 else largest
            gaps = [abs(other - mesh) / scale if scale else 0.0 for other in (finer, adaptive)]
            rows.append(Row(name, parameter, mesh, finer, adaptive, *gaps))
            passed &= max(gaps) <= (DERIVATIVES if p else VALUES)
    return Convergence(tuple(rows), bool(passed))
