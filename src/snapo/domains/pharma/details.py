"""Tables of a pharma run as plain data (`details.json`): one batch, its checks, its derivatives."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from . import (
    attribution,
    batches,
    design_space,
    estimation,
    optimise,
    ranges,
    sensitivities,
)
from .balances import balances
from .capability import Capability
from .certify import certify
from .convergence import convergence
from .draws import all_entries
from .inputs import every_entry, pharma_inputs
from .jacobian import matrix, second
from .limits import Limits
from .local import local
from .ports import states
from .process import Process, Run
from .profile import with_nodes
from .records import PharmaCase
from .records_units import Crystalliser, Dryer, Timed

SHOWN = 240  # points of a trajectory that a report shows
NODES = 61  # of a profile whose sensitivity over time is shown
BATCHES, RANGE_SAMPLES = 4096, 128


def one_batch(case: PharmaCase, run: Run | None) -> dict[str, Any] | None:
    """Attributes with their limits, measures, and thinned trajectories."""
    if run is None:
        return None
    limits = Limits.of(case)
    values = np.array([run.attributes.get(each.name, np.nan) for each in case.attributes])
    room = limits.distance(values)
    return {
        "status": run.status,
        "attributes": dict(zip([each.name for each in case.attributes], values)),
        "holds": limits.hold(values),
        "distance": np.where(np.isfinite(room), room, np.nan),
        "measures": dict(run.measures),
        "trajectories": {unit: _thin(table) for unit, table in run.trajectories.items()},
        "solubility": _solubility(case, run),
    }


def _thin(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Points evenly spread over time; the mesh itself crowds around events."""
    time = np.asarray(table["time"], np.float64)
    wanted = np.linspace(time[0], time[-1], min(SHOWN, len(time)))
    return {"time": wanted} | {
        name: np.interp(wanted, time, np.asarray(column, np.float64))
        for name, column in table.items()
        if name != "time"
    }


def _solubility(case: PharmaCase, run: Run) -> dict[str, Any]:
    """{crystalliser: temperatures and c* on them}, from the states that were recorded."""
    found = {}
    for unit in case.units:
        table = run.trajectories.get(unit.name)
        if isinstance(unit, Crystalliser) and table is not None:
            c, s = np.asarray(table["concentration"]), np.asarray(table["supersaturation"])
            order = np.argsort(np.asarray(table["temperature"]), kind="stable")
            every = order[:: max(1, len(order) // SHOWN)]
            found[unit.name] = {
                "temperature": np.asarray(table["temperature"])[every],
                "solubility": (c / (1 + s))[every],
            }
    return found


def balance_rows(process: Process) -> list[dict[str, Any]]:
    return [each._asdict() for each in balances(process)]


def convergence_rows(process: Process) -> dict[str, Any]:
    found = convergence(process)
    return {"passed": found.passed, "rows": [row._asdict() for row in found.rows]}


def matrix_tables(process: Process) -> dict[str, Any]:
    """The matrix in its three forms, the mode that was used, and the ranking by criticality.

    One pass serves the parameters and everything else that varies; "varied" is for `spread_rows`.
    """
    case = process.case
    entries = batches.varied(case)
    found = matrix(process, entries=entries)
    columns = [entries.index((each.input, each.entry)) for each in case.parameters]
    forms = sensitivities.table(case, found._replace(jacobian=found.jacobian[:, columns]))
    return {
        "mode": found.mode,
        "reason": found.reason,
        "passes": found.passes,
        "values": found.values,
        **forms._asdict(),
        "ranking": [rank._asdict() for rank in sensitivities.ranking(case, forms)],
        "varied": found.jacobian[:, : len(all_entries(case))],
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


def attribution_rows(process: Process, found: dict[str, Any] | None) -> dict[str, Any] | None:
    """Every sensitivity by path, and the check that the paths add up."""
    if found is None:
        return None
    case = process.case
    split = attribution.split(case, local(process), np.asarray(found["raw"]))
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
        if not isinstance(unit, Timed | Dryer):
            continue
        if unit.temperature.kind != "linear":
            continue
        name = unit.temperature.value.name
        fine = with_nodes(case, name, NODES)
        process = Process(fine)
        share = np.linspace(0, 1, NODES)
        duration = float(unit.duration.values[0])
        weight = np.gradient(share) * duration
        weight[[0, -1]] /= 2
        found_here = matrix(process, entries=tuple((name, i) for i in range(NODES)))
        slopes = dict(zip(process.names, found_here.jacobian))
        value = unit.temperature.value.used()
        found.append(
            {
                "unit": unit.name,
                "time": share * duration,
                "temperature": np.interp(share, unit.temperature.share, value),
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


def batch_count(case: PharmaCase) -> int:
    """Fresh batches for capability."""
    return min(case.evaluation.paths, BATCHES)


def capability_rows(case: PharmaCase, found: Capability | None) -> dict[str, Any] | None:
    if found is None:
        return None
    table = found._asdict()
    return {key: table.pop(key) for key in ("joint", "joint_error", "batches", "failed")} | table


def spread_rows(case: PharmaCase, found: dict[str, Any] | None) -> dict[str, Any] | None:
    """Where the spread comes from, to first order, to stand beside what was drawn."""
    if found is None:
        return None
    return sensitivities.spread(case, np.asarray(found["varied"]))._asdict()


def best_recipe(process: Process, sampled: Process, seed: int) -> dict[str, Any]:
    """The recipe that `[optimise]` asks for; `sampled` measures what it promises."""
    return optimise.table(sampled, optimise.optimise(process, seed), seed + 2)


def map_tables(process: Process, seed: int) -> dict[str, Any]:
    """The map, its sampling error and binding attribute, and the largest box inside."""
    case = process.case
    found = design_space.probability_map(process, seed)
    space = case.design_space
    assert space is not None
    chosen = [design_space.parameter(case, name) for name in space.axes]
    here = [float(design_space.owners(p, ranges.set_point(process, p))) for p in chosen]
    box = design_space.largest_box(found, here, space.required)
    return {
        "axes": list(found.axes),
        "units": [each.unit for each in chosen],
        "grid": list(found.grid),
        **found.at._asdict(),
        "samples": found.samples,
        "levels": list(space.levels),
        "required": space.required,
        "nominal": here,
        "normal": [
            [design_space.owners(p, p.normal_low), design_space.owners(p, p.normal_high)]
            for p in chosen
        ],
        "box": None if box is None else box._asdict(),
    }


def range_rows(process: Process, seed: int) -> list[dict[str, Any]]:
    """Both proven ranges of every parameter that the designer may choose."""
    space = process.case.design_space
    assert space is not None
    found = ranges.proven_ranges(process, space.required, RANGE_SAMPLES, seed)
    return [
        {
            "parameter": each.parameter, "unit": each.unit, "required": space.required,
            "samples": RANGE_SAMPLES, "nominal": each.nominal._asdict(),
            "probable": each.probable._asdict(),
        }
        for each in found
    ]  # fmt: skip


def estimation_rows(process: Process) -> dict[str, Any]:
    given = process.case.estimation
    assert given is not None
    found = estimation.fit(process, given)
    start = [process.inputs[name][entry] for name, entry in zip(given.inputs, given.entries)]
    return {
        **found._asdict(), "start": start, "level": given.level,
        "state": [state for each in given.experiments for state in each.state],
        "time": np.concatenate([each.time for each in given.experiments]),
        "experiment": [each.name for each in given.experiments for _ in each.time],
    }  # fmt: skip


def every_sensitivity(process: Process) -> Iterable[tuple]:
    """attribute, input, label, value, unit: by all numbers of the case."""
    inputs = pharma_inputs(process.case)
    entries = every_entry(process.inputs)
    found = matrix(process, entries=entries, mode="adjoint").jacobian
    for attribute, row in zip(process.case.attributes, found):
        for (name, i), value in zip(entries, row.tolist()):
            unit = f"({attribute.unit})/({inputs[name].unit})"
            yield attribute.name, name, inputs[name].labels[i], value, unit


def profile_rows(case: PharmaCase, run: dict[str, Any]) -> Iterable[tuple]:
    """unit, time, state, value and its unit: trajectories in long form."""
    for unit in case.units:
        table = run["trajectories"].get(unit.name, {})
        for state, measured in states(unit, case.network.species).items():
            for time, value in zip(table.get("time", ()), table.get(state, ())):
                yield unit.name, float(time), state, float(value), measured


def space_rows(found: dict[str, Any]) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `design_space.csv`: one row per point of the map."""
    grid = [x.ravel() for x in np.meshgrid(*found["grid"], indexing="ij")]
    names = tuple(f"{name} [{unit}]" for name, unit in zip(found["axes"], found["units"]))
    columns = [*grid, *(np.ravel(found[key]) for key in ("probability", "error", "binding"))]
    return (*names, "probability", "standard_error", "binding"), zip(*(c.tolist() for c in columns))
