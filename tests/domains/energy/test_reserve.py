"""Capacity of a battery that is sold as reserve, by the hour or by the block of an auction."""

import datetime
import shutil
from itertools import groupby

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import HOME, battery, case_at, exact

from snapo.case.error import CaseError
from snapo.case.quantity import numbers_in

START = datetime.datetime(2026, 5, 4)


def with_prices(folder, prices, reserve_prices, stock, **changes):
    """The template with these prices by the hour, of energy and of reserve; other keys changed."""
    shutil.copytree(HOME / "template_battery", folder, dirs_exist_ok=True)
    times = [START + datetime.timedelta(hours=n) for n in range(len(prices) + 1)]
    for name, numbers in (("curve", prices), ("reserve", reserve_prices)):
        rows = [f"{time:%Y-%m-%dT%H:%M},{float(x)!r}" for time, x in zip(times, numbers)]
        (folder / f"{name}.csv").write_text("\n".join(["time,price", *rows]))
    keys = {"start": START, "end": times[-1], "cycles": None} | changes
    keys |= {"reserve": {"price": "reserve.csv", "stock": stock}}
    return case_at(folder, {f"contract.{name}": value for name, value in keys.items()})


def best_plan(case, hours_of_block):
    """The best plan at forward prices, by a mixed-integer program: charge, discharge and reserve of
    each hour, the same reserve in all hours of a block; both are at most zero in reserve."""
    contract, price = case.contract, np.asarray(case.market.forward_curve.used())
    numbers = {x.name: float(x.values[0]) for x in numbers_in(contract)}
    paid = np.broadcast_to(contract.reserve.price.used(), price.shape)
    count, energy, stored = len(price), numbers["energy"], numbers["stored"]
    into, out = numbers["charge_efficiency"], numbers["discharge_efficiency"]
    power = min(numbers["charge_power"], numbers["discharge_power"] * out)
    most = np.array([numbers["charge_power"] * into, numbers["discharge_power"]])
    low, high = contract.reserve.stock
    below, one, none = np.tri(count), np.eye(count), np.zeros((count, count))
    level = np.hstack([below, -below, none])
    rows = [
        (level, -stored, energy - stored),
        (np.hstack([one, none, most[0] * one]), -np.inf, most[0]),
        (np.hstack([none, one, most[1] * one]), -np.inf, most[1]),
        (level - low * np.hstack([none, none, one]), -stored, np.inf),
        (level + (energy - high) * np.hstack([none, none, one]), -np.inf, energy - stored),
    ]
    same = np.flatnonzero(np.arange(1, count) % hours_of_block)
    rows.append((np.hstack([none, none, one - np.eye(count, k=1)])[same], 0.0, 0.0))
    for name, spans in (
        ("cycles_day", groupby(range(count), lambda n: case.days[n])),
        ("cycles_term", [(0, range(count))]),
    ):
        for _, hours in spans if name in numbers else []:
            row = np.zeros((1, 3 * count))
            row[0, [count + n for n in hours]] = 1.0
            rows.append((row, -np.inf, numbers[name] * energy))
    gain = np.concatenate([-price / into, out * price - numbers["wear"], paid * power])
    upper = np.concatenate([np.repeat(most, count), np.ones(count)])
    result = milp(
        -gain,
        integrality=np.repeat([0, 0, 1], count),
        bounds=Bounds(0, upper),
        constraints=[LinearConstraint(*row) for row in rows],
        options={"mip_rel_gap": 1e-9},
    )
    assert result.success
    return -result.fun


DRAWS = np.random.default_rng(7)
SMALL = [
    ({}, 1, [1.0, 3.0]),
    ({"auction": {"step": "4h"}}, 4, [1.0, 3.0]),
    ({"auction": {"step": "2h"}, "stored": 2.0, "cycles": {"day": 0.5}}, 2, [0.5, 2.5]),
    ({"cycles": {"term": 0.6}, "stored": 1.3}, 1, [2.0, 2.2]),
    ({"charge": {"power": 2.0, "efficiency": 0.8}, "stored": 4.0}, 1, [0.0, 1.5]),
    ({"auction": {"step": "3h"}, "wear": 0.0}, 3, [3.5, 4.0]),
]


@pytest.mark.parametrize("changes, block, stock", SMALL)
def test_without_volatility_it_is_the_best_plan(changes, block, stock, tmp_path):
    """A mixed-integer program, for two draws of the prices of energy and of reserve."""
    for k in range(2):
        draws = np.random.default_rng([k, len(stock), block])
        prices, paid = 60 + 20 * draws.normal(size=12), 12 * draws.uniform(size=12)
        case = with_prices(tmp_path / str(k), prices, paid, stock, **changes)
        value = best_plan(case, block)
        assert exact(case, forward=True) == pytest.approx(value, rel=1e-6)
