"""Derivatives of a run as tables of plain data: the matrix, its checks, its split by path."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..derivatives import attribution, sensitivities
from ..derivatives.certify import certify
from ..derivatives.convergence import convergence
from ..derivatives.grids import on_finer_cells
from ..derivatives.jacobian import matrix, second
from ..derivatives.local import local
from ..derivatives.nodes import with_nodes
from ..flowsheet.case import PharmaCase
from ..flowsheet.inputs import pharma_inputs
from ..flowsheet.process import Process
from ..given import every_entry
from ..quality import batches, design_space
from ..quality.draws import all_entries

NODES = 61  # of a profile whose sensitivity over time is shown


def convergence_rows(process: Process) -> dict[str, Any]:
    """In time, and on cells along a length and over sizes where there are any."""
    found = convergence(process)
    cells = [each._asdict() | {"passed": each.passed} for each in on_finer_cells(process)]
    return {
        "passed": found.passed,
        "rows": [row._asdict() for row in found.rows],
        "cells": cells,
    }


def matrix_tables(process: Process) -> dict[str, Any]:
    """The matrix in its three forms, the mode that was used, and the ranking by criticality.

    One pass serves the parameters and everything else that varies; "varied" is for `spread_rows`.
    """
    case = process.case
    entries = batches.varied(case)
    found = matrix(process, entries=entries)
    columns = [entries.index((each.input, each.entry)) for each in case.parameters]
    forms = sensitivities.table(case, found._replace(jacobian=found.jacobian[:, columns]))
    moving = found.jacobian[:, : len(all_entries(case))]
    varied = sensitivities.spread(case, moving)
    ranks = sensitivities.ranking(case, forms, found, varied)
    return {
        "mode": found.mode,
        "reason": found.reason,
        "passes": found.passes,
        "values": found.values,
        **forms._asdict(),
        "ranking": [rank._asdict() for rank in ranks],
        "varied": moving,
    }


def certificate_rows(process: Process, seed: int) -> list[dict[str, Any]]:
    names = [each.name for each in process.case.attributes]
    parameters = process.case.parameters
    rows = []
    for i, checked in enumerate(certify(process, seed)):
        worst = np.unravel_index(int(checked.error.argmax()), checked.error.shape)
        rows.append(
            {
                "point": "set point" if i == 0 else f"random point {i}",
                "at": [design_space.owners(p, x) for p, x in zip(parameters, checked.point)],
                "worst": float(checked.error.max()),
                "attribute": names[int(worst[0])],
                "parameter": parameters[int(worst[1])].name,
                "kinks": int(checked.kink.sum()),
                "passed": checked.passed,
            }
        )  # fmt: skip
    return rows


def attribution_rows(process: Process, matrix: dict[str, Any]) -> dict[str, Any]:
    """Every sensitivity of the `matrix` by path, and the check that the paths add up."""
    case = process.case
    split = attribution.split(case, local(process), np.asarray(matrix["raw"]))
    return {
        "closure": float(split.closure.max()),
        "paths": [
            {
                "attribute": attribute, "parameter": parameter, "units": list(way.units),
                "value": way.value,
            }
            for (attribute, parameter), ways in split.paths.items()
            for way in ways
        ],
        "by_unit": [
            {"unit": unit, "attribute": attribute, "value": value}
            for (unit, attribute), value in attribution.by_unit(case, split).items()
        ],
    }  # fmt: skip


def profile_gradients(case: PharmaCase) -> list[dict[str, Any]]:
    """d attribute / d temperature over time, per K held for ten minutes: one adjoint each.

    The profile gets many nodes; the derivative by one is spread over the time that it stands for.
    """
    found = []
    for unit in case.units:
        name = f"{unit.name}.temperature"
        profile = next((each for each in unit.profiles if each.value.name == name), None)
        if unit.time is None or profile is None or profile.kind != "linear":
            continue
        fine = with_nodes(case, name, NODES)
        process = Process(fine)
        share = np.linspace(0, 1, NODES)
        duration = float(unit.time.values[0])
        weight = np.gradient(share) * duration
        weight[[0, -1]] /= 2
        found_here = matrix(process, entries=tuple((name, i) for i in range(NODES)))
        slopes = dict(zip(process.names, found_here.jacobian))
        value = profile.value.used()
        found.append(
            {
                "unit": unit.name,
                "time": share * duration,
                "temperature": np.interp(share, profile.share, value),
                "slope": {key: x / weight * 600 for key, x in slopes.items() if x.any()},
            }
        )  # fmt: skip
    return found


def second_rows(process: Process) -> list[dict[str, Any]]:
    """Second derivatives in owners' units, for the pairs that the case names."""
    case = process.case
    pairs = [tuple(design_space.parameter(case, n) for n in pair) for pair in case.pairs]
    entries = tuple(((a.input, a.entry), (b.input, b.entry)) for a, b in pairs)
    found = second(process, entries)
    return [
        {"pair": list(names), "values": row * a.scale * b.scale}
        for names, (a, b), row in zip(case.pairs, pairs, found)
    ]


def every_sensitivity(process: Process) -> Iterable[tuple]:
    """attribute, input, label, value, unit: by all numbers of the case."""
    inputs = pharma_inputs(process.case)
    entries = every_entry(process.inputs)
    found = matrix(process, entries=entries, mode="adjoint").jacobian
    for attribute, row in zip(process.case.attributes, found):
        for (name, i), value in zip(entries, row.tolist()):
            unit = f"({attribute.unit})/({inputs[name].unit})"
            yield attribute.name, name, inputs[name].labels[i], value, unit
