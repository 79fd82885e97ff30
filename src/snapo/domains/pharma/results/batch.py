"""One batch as tables of plain data: attributes with limits, trajectories, balances."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..flowsheet.balances import balances
from ..flowsheet.case import PharmaCase
from ..flowsheet.process import Process, Run
from ..quality.limits import Limits

SHOWN = 240  # points of a trajectory that a report shows


def one_batch(case: PharmaCase, run: Run) -> dict[str, Any]:
    """Attributes with their limits, measures, and thinned trajectories."""
    limits = Limits.of(case)
    values = np.array([run.attributes.get(each.name, np.nan) for each in case.attributes])
    room = limits.distance(values)
    return {
        "status": run.status,
        "steps": case.numerics.steps,
        "errors": dict(run.errors),
        "loops": [
            {"loop": name, "change": change, "rounds": rounds}
            for name, (change, rounds) in run.loops.items()
        ],
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
    """{unit: temperatures and c* on them}, from the states that were recorded."""
    found = {}
    for unit in case.units:
        table = run.trajectories.get(unit.name)
        if table is not None and {"concentration", "supersaturation"} <= set(table):
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


def profile_rows(case: PharmaCase, run: dict[str, Any]) -> Iterable[tuple]:
    """unit, time, state, value and its unit: trajectories in long form."""
    for unit in case.units:
        table = run["trajectories"].get(unit.name, {})
        for state, measured in unit.states(case.network.species).items():
            for time, value in zip(table.get("time", ()), table.get(state, ())):
                yield unit.name, float(time), state, float(value), measured
