"""A battery whose prices do not move: policy, lattice and bound against a linear program."""

import datetime as dt
import shutil
import zoneinfo

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog
from tests.domains.energy.energy_cases import HOME, battery, case_at, exact

from snapo.domains.energy.core.gains import FlowRows
from snapo.domains.energy.core.policy import UnitValuePolicy
from snapo.domains.energy.core.tables import LevelRows, UnitValues
from snapo.domains.energy.methods.corners import corners
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.methods.intrinsic import intrinsic_value
from snapo.domains.energy.setup import make_setup
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate

ENERGY, OUT, WEAR = 4.0, 0.95, 3.0  # of the template
STILL = 1e-9


def swinging(k: int, hour: int) -> float:
    return 60 + 25 * np.sin(hour / 6 * np.pi + 1) + 7 * np.cos(1.7 * k)


def negative(k: int, hour: int) -> float:
    return -20 + 30 * np.sin(k / 3)


def still(folder, begin: str, hours: int, zone: str, price, changes):
    """A case of the template without volatility, and the price and the local date of its hours."""
    shutil.copytree(HOME / "template_battery", folder)
    where = zoneinfo.ZoneInfo(zone)
    start = dt.datetime.fromisoformat(begin)
    first = start.replace(tzinfo=where).astimezone(dt.UTC)
    local = [(first + dt.timedelta(hours=k)).astimezone(where) for k in range(hours + 1)]
    prices = np.array([price(k, x.hour) for k, x in enumerate(local[:-1])])
    rows = [f"{x:%Y-%m-%dT%H:%M},{float(p)!r}" for x, p in zip(local, prices)]
    (folder / "curve.csv").write_text("\n".join(["time,price", *rows]) + "\n")
    keys = {"contract.time_zone": zone, "contract.start": start, "model.volatility": STILL}
    keys |= {"contract.end": local[-1].replace(tzinfo=None), "market.valuation_date": start.date()}
    return case_at(folder, keys | changes), prices, [x.date() for x in local[:-1]]


def program(price, days, into: float, power: float, stored: float) -> float:
    """The most that `power` bought, of which `into` is stored, and 1 MW taken can earn."""
    count = len(price)
    below = np.tri(count)
    filled = np.hstack([into * below, -below])
    daily = np.array([[x == day for x in days] for day in sorted(set(days))], float)
    limits = np.concatenate([np.full(count, ENERGY - stored), np.full(count, stored),
                             np.full(len(daily), ENERGY)])  # fmt: skip
    rows = np.vstack([filled, -filled, np.hstack([np.zeros_like(daily), daily])])
    cost = np.concatenate([price, WEAR - OUT * price])
    return -linprog(cost, rows, limits, bounds=[(0, power)] * count + [(0, 1)] * count).fun


MORE = {"contract.stored": 2.5, "contract.charge": {"power": 2.0, "efficiency": 0.9}}
CASES = {
    "23 hours": ("prove", "2026-03-28", 47, "Europe/Berlin", swinging, {}, 1.0, 0.0),
    "25 hours": ("study", "2026-10-24", 49, "Europe/Berlin", swinging, {}, 1.0, 0.0),
    "negative": (
        "study",
        "2026-05-04",
        48,
        "UTC",
        negative,
        {"model.kind": "one-factor-normal"},
        1.0,
        0.0,
    ),
    "energy in store": ("prove", "2026-05-04", 24, "UTC", swinging, MORE, 2.0, 2.5),
}


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=getattr(pytest.mark, suite)) for x, (suite, *_) in CASES.items()]
)
def test_policy_lattice_and_bound_are_the_best_plan(name, tmp_path):
    """Charges of 0.9 and 1.8 MWh and discharges of 1 MWh: best volumes are multiples of 0.1 MWh."""
    _, begin, hours, zone, price, changes, power, stored = CASES[name]
    case, prices, days = still(tmp_path / "case", begin, hours, zone, price, changes)
    best = program(prices, days, 0.9, power, stored)
    assert exact(case, forward=True) == pytest.approx(best, rel=1e-9)
    setup = make_setup(case, "xla")
    assert isinstance(setup.policy, UnitValuePolicy)
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = bound(problem, rule, relaxation=EnergyRelaxation(problem), engine=engine, paths=64)
    lower, gap = result.lower, result.gap
    assert lower.standard_error < 1e-5 * best
    assert abs(lower.value - best) <= 3 * lower.standard_error
    assert 0 <= gap.value <= 1e-9 * best


def table_of(gains, down: bool) -> UnitValues:
    """One level with rows 0.1 apart: the value of one more unit of each row along one flow."""
    slopes = np.append(gains, 0.0)[::-1] if down else np.append(gains, 0.0)
    units = jnp.full((1, len(gains).bit_length()), 0.1)
    rows = LevelRows(jnp.zeros(1), jnp.full(1, 0.1))
    return UnitValues(rows, jnp.asarray(slopes)[None, :, None], None, None, units)  # pyright: ignore


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("taken", [0, 1, 6, 9])
def test_the_last_row_that_gains_is_found(taken, down):
    """Of nine rows the first ones gain 1, the others lose 1; from between rows, both ways."""
    gains = np.where(np.arange(9) < taken, 1.0, -1.0)
    for begin in (0.0, 0.03):
        free = 0.9 - begin
        start = jnp.array([free if down else begin])
        flow = FlowRows(table_of(gains, down), 0, (-1.0 if down else 1.0,), start, 0, (1,))
        result = flow.gains(jnp.zeros(()), jnp.asarray(free), jnp.ones(1), jnp.zeros(()))
        positions = np.array([0.0, *result.positions, 1.0])
        positive = [min(unit) > 0 for unit in result.units]
        assert free * np.diff(positions) @ positive == pytest.approx(
            max(0.1 * taken - begin, 0.0), abs=1e-6
        )


@pytest.mark.parametrize("effects", [(1.0, 0.0), (-1.0, 1.0), (-1.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("start", [(0.43, 0.21), (0.5, 0.24), (0.48, 0.335), (0.63, 0.19)])
def test_the_last_piece_that_gains_is_the_best_volume(effects, start):
    """Of a concave value between rows whose levels lie apart, against 2,000 volumes."""
    nodes = np.arange(12) * 0.1, np.arange(11) * 0.1 - 0.06
    one, two = np.meshgrid(*nodes, indexing="ij")
    value = -((one - 0.35) ** 2) - (two - 0.3) ** 2 - 0.7 * (one + two - 0.6) ** 2
    steps, slopes = (int(x) for x in effects), np.zeros(value.shape)
    (a, b), (rows, columns) = steps, value.shape
    inside = (slice(max(-a, 0), rows - max(a, 0)), slice(max(-b, 0), columns - max(b, 0)))
    moved = tuple(slice(x.start + n, x.stop + n) for x, n in zip(inside, (a, b)))
    slopes[inside] = (value[moved] - value[inside]) / 0.1
    low, free = jnp.array([0.0, -0.06]), 0.42
    rows_of, pieces = LevelRows(low, jnp.full(2, 0.1)), jnp.full((1, 4), 0.1)
    table = UnitValues(rows_of, jnp.asarray(slopes)[None, :, :, None], None, None, None, pieces)  # pyright: ignore
    for unit in (-0.4, 0.0, 0.3, 0.8):
        flow = FlowRows(table, 0, effects, jnp.array(start), 0, (1, -1))
        result = flow.gains(jnp.zeros(()), jnp.asarray(free), jnp.ones(1), jnp.asarray(unit))
        positions = np.array([0.0, *result.positions, 1.0])
        positive = [min(gain) > 0 for gain in result.units]
        volumes = np.linspace(0, free, 2001)
        points = np.array(start) + volumes[:, None] * np.array(effects)
        numbers, weights = corners(nodes, points, (1, -1))
        totals = unit * volumes + np.sum(value.ravel()[numbers] * weights, axis=0)
        volume = free * np.diff(positions) @ positive
        assert volume == pytest.approx(volumes[np.argmax(totals)], abs=3e-4)


@pytest.mark.parametrize(
    "hours", [pytest.param(8, marks=pytest.mark.prove), pytest.param(24, marks=pytest.mark.study)]
)
def test_a_policy_on_coarse_nodes_has_the_value_of_the_lattice(hours, tmp_path):
    """4.04 MWh have nodes 0.1 MWh apart: policies that drew lines between them had 39.99 for 41.01
    and 168.8 for 169.8, below the intrinsic value of eight hours."""
    end = dt.datetime(2026, 5, 4) + dt.timedelta(hours=hours)
    case = battery(energy=4.04, end=end)
    setup = make_setup(case, "native")
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = evaluate(problem, rule, paths=16384, engine=engine)
    error = 3 * result.standard_error
    assert result.value >= intrinsic_value(case.contract.layout, problem.schedule) - error
    assert result.value == pytest.approx(exact(case, finer=1), rel=5e-4, abs=error)
