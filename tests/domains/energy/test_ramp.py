"""A plant with a ramp, against integer programs, the plant without one, and lattices."""

import datetime
import shutil

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import HOME, case_at, exact, plant

from snapo.domains.energy.contracts.ramp import power_steps

HOURS = 20


def integer_program(power, gas, limits, starts, minimum, before):
    """The best plan at known prices: unit commitment with continuous powers.

    The three-binary formulation of pglib-uc (github.com/power-grid-lib/pglib-uc, MODEL.md), with
    one limit max(min, ramp) of the first and of the last hour on. `limits`: min, max, ramp;
    `minimum`: hours on and off; `before`: (on, hours, power).
    """
    least, most, ramp = limits
    (min_up, min_down), (was_on, hours, level) = minimum, before
    count, kinds, top = len(power), len(starts), min(max(least, ramp), most)
    idle, rate, price, other = 45.0, 1.6, 14.0, 1.5
    fuel = gas + price
    names = ["q", "on", "up", "down", *(f"kind {k}" for k in range(kinds))]
    size = count * len(names)

    def var(name, t):
        row = np.zeros(size)
        if t >= 0:
            row[names.index(name) * count + t] = 1.0
        return row

    def past(name, t):
        """A known number of an hour before the first one."""
        if t >= 0:
            return 0.0
        return {
            "q": level if was_on else 0.0,
            "on": float(was_on),
            "up": float(was_on and t == -hours),
            "down": float(not was_on and t == -hours),
        }[name]

    rows, lows, highs = [], [], []

    def add(parts, low, high):
        """low <= sum of factor x variable <= high."""
        known = sum(x * past(name, t) for x, name, t in parts)
        rows.append(sum(x * var(name, t) for x, name, t in parts))
        lows.append(low - known)
        highs.append(high - known)

    for t in range(count):
        add([(1, "q", t), (-least, "on", t)], 0, np.inf)
        add([(1, "q", t), (-most, "on", t)], -np.inf, 0)
        add([(1, "on", t), (-1, "on", t - 1), (-1, "up", t), (1, "down", t)], 0, 0)
        add([(1, "up", s) for s in range(t - min_up + 1, t + 1)] + [(-1, "on", t)], -np.inf, 0)
        add([(1, "down", s) for s in range(t - min_down + 1, t + 1)] + [(1, "on", t)], -np.inf, 1)
        step = [(1, "q", t), (-1, "q", t - 1)]
        add([*step, (-ramp, "on", t - 1), (-top, "up", t)], -np.inf, 0)
        add([*step, (ramp, "on", t), (top, "down", t)], 0, np.inf)
        add([(1, "up", t), *((-1, f"kind {k}", t) for k in range(kinds))], 0, 0)
        for k in range(kinds - 1):
            window = range(starts[k][0], starts[k + 1][0])
            add([(1, f"kind {k}", t), *((-1, "down", t - i) for i in window)], -np.inf, 0)
    cost = np.zeros((len(names), count))
    cost[0] = power - rate * fuel - other
    cost[1] = -idle * fuel
    for k, (_, money, burnt) in enumerate(starts):
        cost[4 + k] = -money - burnt * fuel
    whole = np.repeat(np.arange(len(names)) > 0, count).astype(int)
    high = np.repeat([most, *np.ones(len(names) - 1)], count)
    result = milp(
        -cost.ravel(),
        integrality=whole,
        bounds=Bounds(np.zeros(size), high),
        constraints=LinearConstraint(np.array(rows), lows, highs),
        options={"mip_rel_gap": 0.0},
    )
    assert result.success
    plan = result.x.reshape(len(names), count)
    return -result.fun, plan[1] > 0.5, plan[0]


def case_of(folder, power, gas, limits, starts, minimum, before):
    """The same as a case."""
    rows = [f"2026-01-05T{h:02d}:00,{x!r}" for h, x in enumerate(map(float, power))]
    (folder / "power.csv").write_text("\n".join(["time,price", *rows]))
    rows = [f"2026-01-05T{h:02d}:00,{x!r}" for h, x in enumerate(map(float, gas))]
    (folder / "gas.csv").write_text("\n".join(["time,price", *rows]))
    on, hours, level = before
    changes = {
        "contract.end": datetime.datetime(2026, 1, 5, len(power)),
        "contract.power": dict(zip(("min", "max", "ramp"), limits)),
        "contract.starts": [dict(zip(("off", "money", "fuel"), x)) for x in starts],
        "contract.min_up": minimum[0],
        "contract.min_down": minimum[1],
        "contract.before": {"on": hours, "power": level} if on else {"off": hours},
    }
    return case_at(folder, changes)


@pytest.mark.parametrize("seed", range(8))
def test_integer_programs(seed, tmp_path):
    """At forward prices the value is that of an integer program with continuous powers."""
    folder = shutil.copytree(HOME / "template_plant", tmp_path / "case")
    rng = np.random.default_rng(seed)
    power = 95 + 60 * np.sin(np.arange(HOURS) * rng.uniform(0.4, 0.9)) + rng.normal(0, 25, HOURS)
    gas = rng.uniform(20, 28, HOURS)
    least = float(np.round(rng.uniform(15, 60), 1))
    ramp = float(np.round(rng.uniform(12, 70), 1))
    hours = int(rng.integers(1, 4))
    starts = [(hours, 300.0, 5.0), (hours + 4, 1500.0, 20.0)]
    before = (True, int(rng.integers(1, 5)), 77.3) if seed % 2 else (False, 6, 0.0)
    terms = (least, 110.0, ramp), starts, (int(rng.integers(2, 5)), hours), before
    best, on, volumes = integer_program(power, gas, *terms)
    value = exact(case_of(folder, power, gas, *terms), forward=True)
    assert value == pytest.approx(best, abs=1e-6, rel=1e-9)
    print(seed, value, least, ramp, on.astype(int), np.round(volumes, 1))
