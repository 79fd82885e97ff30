"""Cases of the templates with other keys, and their problems."""

import copy
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.optimize import linprog

import snapo
from snapo.case.load import load
from snapo.case.quantity import numbers_in
from snapo.domains.energy.methods.lattice import lattice
from snapo.domains.energy.read.case import EnergyCase, read_case
from snapo.domains.energy.setup import bare_problem, factors_of

HOME = Path(snapo.__file__).parent / "domains" / "energy"


def case_at(folder: Path, changes: dict[str, Any]) -> EnergyCase:
    """The case of a folder with other values of keys, {"contract.strike": 30.0}; None: without."""
    return read_case(*tables_at(folder, changes))


def tables_at(folder: Path, changes: dict[str, Any]) -> tuple[Path, dict[str, Any]]:
    """The file of a case and its tables, with other values of keys."""
    file, data = load(folder)
    data = copy.deepcopy(data)
    for name, value in changes.items():
        *tables, key = name.split(".")
        table: Any = data
        for item in tables:
            table = table.setdefault(item, {})
        if value is None:
            table.pop(key, None)
        else:
            table[key] = value
    return file, data


def swing(**changes: Any) -> EnergyCase:
    """The template of a swing contract, keys of `[contract]` changed."""
    named = {f"contract.{name}": value for name, value in changes.items()}
    return case_at(HOME / "template_swing", named)


def battery(**changes: Any) -> EnergyCase:
    """The template of a battery, keys of `[contract]` changed."""
    named = {f"contract.{name}": value for name, value in changes.items()}
    return case_at(HOME / "template_battery", named)


def plant(**changes: Any) -> EnergyCase:
    """The template of a power plant, keys of `[contract]` changed."""
    named = {f"contract.{name}": value for name, value in changes.items()}
    return case_at(HOME / "template_plant", named)


def exact(case: EnergyCase, forward: bool = False, finer: int = 2) -> float:
    """The value on a lattice, `finer` than its first one; `forward`: at forward prices."""
    problem = bare_problem(case)
    factors = None if forward else factors_of(problem)
    return lattice(case.contract.layout, problem.schedule, factors, finer=finer).value


def plain(tree):
    """NumPy leaves."""
    return jax.tree.map(np.asarray, tree)


def best_plan(case: EnergyCase) -> float:
    """The best plan of a battery at forward prices, by a linear program."""
    contract, price = case.contract, np.asarray(case.market.forward_curve.used())
    numbers = {x.name: float(x.values[0]) for x in numbers_in(contract)}
    count, energy = len(price), numbers["energy"]
    into, out = numbers["charge_efficiency"], numbers["discharge_efficiency"]
    gain = np.concatenate([-price / into, out * price - numbers["wear"]])
    below = np.tri(count)
    rows, limits = [np.hstack([below, -below])], [np.full(count, energy - numbers["stored"])]
    rows, limits = [*rows, -rows[0]], [*limits, np.full(count, numbers["stored"])]
    ends = np.flatnonzero(contract.day_ends)
    days = [(a, b) for a, b in zip([0, *ends[:-1] + 1], ends + 1)]
    for name, spans in (("cycles_day", days), ("cycles_term", [(0, count)])):
        for first, last in spans if name in numbers else []:
            row = np.zeros((1, 2 * count))
            row[0, count + first : count + last] = 1.0
            rows.append(row)
            limits.append(np.array([numbers[name] * energy]))
    most = [numbers["charge_power"] * into] * count + [numbers["discharge_power"]] * count
    result = linprog(-gain, np.concatenate(rows), np.concatenate(limits),
                     bounds=[(0, x) for x in most])  # fmt: skip
    return -result.fun
