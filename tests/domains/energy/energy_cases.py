"""Cases of the templates with other keys, and their problems."""

import copy
import datetime
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.optimize import linprog

import snapo
from snapo.case.load import load
from snapo.case.quantity import numbers_in
from snapo.domains.energy.core.policy import UnitValuePolicy
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.methods.lattice import lattice, refined
from snapo.domains.energy.read.case import EnergyCase, read_case
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup
from snapo.engine import Engine, EngineName
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.solver.bound import bound

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


def battery_with_prices(
    folder: Path, start: datetime.datetime, prices: Iterable[float], **changes: Any
) -> EnergyCase:
    """The template of a battery in a folder, with these prices by the hour from `start` on and
    without cycles; keys of `[contract]` changed."""
    shutil.copytree(HOME / "template_battery", folder, dirs_exist_ok=True)
    prices = list(prices)
    times = [start + datetime.timedelta(hours=n) for n in range(len(prices) + 1)]
    rows = [f"{time:%Y-%m-%dT%H:%M},{float(price)!r}" for time, price in zip(times, prices)]
    (folder / "curve.csv").write_text("\n".join(["time,price", *rows]))
    keys = {"start": start, "end": times[-1], "cycles": None} | changes
    return case_at(folder, {f"contract.{name}": value for name, value in keys.items()})


def plant(**changes: Any) -> EnergyCase:
    """The template of a power plant, keys of `[contract]` changed."""
    named = {f"contract.{name}": value for name, value in changes.items()}
    return case_at(HOME / "template_plant", named)


def exact(case: EnergyCase, forward: bool = False, finer: int = 2) -> float:
    """The value on a lattice, `finer` than its first one; `forward`: at forward prices."""
    problem = bare_problem(case)
    factors = None if forward else factors_of(problem)
    return lattice(case.contract.layout, problem.schedule, factors, finer=finer).value


class ValuedRule(NamedTuple):
    """A case made ready, the rule that its training begins with, and the engine of its value."""

    problem: Problem
    rule: Policy
    engine: Engine


def rule_between(
    case: EnergyCase, below: float, above: float, engine: EngineName = "native"
) -> ValuedRule:
    """The rule of the fitted value: its value is at least `below` times that on the lattice, and
    the bound at most `above` times, each within three standard errors."""
    problem = bare_problem(case)
    best = refined(case.contract.layout, problem.schedule, factors_of(problem)).value
    setup = make_setup(case, engine)
    assert isinstance(setup.policy, UnitValuePolicy)
    problem, rule, local = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = bound(problem, rule, relaxation=EnergyRelaxation(problem), engine=local, paths=2048)
    lower, upper = result.lower, result.upper
    assert lower.value >= best * below - 3 * lower.standard_error
    assert lower.value <= best + 3 * lower.standard_error
    assert best - 3 * upper.standard_error <= upper.value
    assert upper.value <= best * above + 3 * upper.standard_error
    return ValuedRule(problem, rule, local)


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
