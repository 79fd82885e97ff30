"""Prepared schedules of the published cases, built from their inputs by hand.

A stand-in for `Simulator.prepare`, written independently of it: same fields, NumPy leaves. Each
builder says where its inputs come from.
"""

import datetime
from collections import namedtuple
from types import SimpleNamespace

import numpy as np

from snapo.domains.gas_storage.prices.process import GaussianFactors

Schedule = namedtuple("Schedule", "constants steps dates factors")
Factor = namedtuple("Factor", "mean_reversion loading")


def date(text: str) -> datetime.date:
    return datetime.date.fromisoformat(text)


def build(
    valuation,
    start,
    end,
    inventory,
    ratchets,
    limits,
    curve,
    factors,
    *,
    discount=lambda day: 1.0,
    settle=lambda day: day,
    costs=(0.0, 0.0),
    correlation=None,
    end_level=None,
    end_values=None,
    end_fraction=0.0,
    interpolation="linear",
    **daily,
):
    """A schedule; `ratchets(day)` gives (inventories, withdrawal, injection), `daily` overrides.

    `end_level`: the inventory that is due at the end, or the least and the most.
    """
    first, last = max(date(valuation), date(start)), date(end)
    dates = [first + datetime.timedelta(n) for n in range((last - first).days)]
    horizon = len(dates)
    zero = np.zeros(horizon)
    rows = [np.array(ratchets(day), float) for day in dates]
    steps = SimpleNamespace(
        day=np.array([(day - date(valuation)).days for day in dates], float),
        forward=np.array([curve(day) for day in dates], float),
        gas_discount=np.array([discount(settle(day)) for day in dates]),
        flow_discount=np.array([discount(day) for day in dates]),
        injection_cost=zero + costs[0],
        withdrawal_cost=zero + costs[1],
        injection_cost_discount=np.array([discount(day) for day in dates]),
        withdrawal_cost_discount=np.array([discount(day) for day in dates]),
        inventory_cost=zero,
        injection_fuel=zero,
        withdrawal_fuel=zero,
        inventory_loss=zero,
        min_injection=zero,
        min_withdrawal=zero,
        levels=np.array([row[0] for row in rows]),
        withdrawal_rate=np.array([row[1] for row in rows]),
        injection_rate=np.array([row[2] for row in rows]),
    )
    for name, values in daily.items():
        setattr(steps, name, np.asarray(values, float) + zero)
    _add_limits(steps, interpolation, limits, end_level)
    prices = price_factors(valuation, [*dates, last], factors, correlation)
    table = end_values or ([0.0, 1.0], [0.0, 0.0])
    constants = SimpleNamespace(
        inventory=float(inventory),
        end_levels=np.array(table[0], float),
        end_values=np.array(table[1], float),
        end_fraction=float(end_fraction),
        end_forward=float(curve(last)) if end_fraction else 0.0,
        end_discount=discount(last),
        fixed_costs=0.0,
    )
    return Schedule(constants, steps, dates, prices)


def _add_limits(steps, interpolation, limits, end_level):
    """The interval that can still meet the end, by bisection (monotone moves only)."""
    low, high = limits
    lows, highs = (
        [float(item)] for item in np.broadcast_to(limits if end_level is None else end_level, 2)
    )
    for t in reversed(range(len(steps.forward))):

        def rate(rates, stock, t=t):
            if interpolation == "step":
                row = np.searchsorted(steps.levels[t], stock, side="right") - 1
                return rates[t][max(row, 0)]
            return np.interp(stock, steps.levels[t], rates[t])

        def least(stock, t=t):
            forced = steps.min_injection[t]
            out = forced if forced > 0 else -rate(steps.withdrawal_rate, stock)
            return stock * (1 - steps.inventory_loss[t]) + out

        def most(stock, t=t):
            forced = steps.min_withdrawal[t]
            into = -forced if forced > 0 else rate(steps.injection_rate, stock)
            return stock * (1 - steps.inventory_loss[t]) + into

        below, above = lows[0], highs[0]
        lows.insert(0, _edge(lambda stock, x=below: most(stock) >= x, high, low))
        highs.insert(0, _edge(lambda stock, x=above: least(stock) <= x, low, high))
    steps.low, steps.high = np.array(lows[:-1]), np.array(highs[:-1])
    steps.next_low, steps.next_high = np.array(lows[1:]), np.array(highs[1:])


def _edge(good, inside, outside):
    """The last good inventory on the way from `inside` to `outside`."""
    if good(outside):
        return outside
    for _ in range(100):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if good(middle) else (inside, middle)
    return inside


def price_factors(valuation, dates, factors, correlation) -> GaussianFactors:
    """Exact covariances of Ornstein-Uhlenbeck factors of unit volatility, and their loadings."""
    years = np.array([(day - date(valuation)).days for day in dates]) / 365
    reversion = np.array([factor.mean_reversion for factor in factors])
    loading = np.array([[factor.loading(day) for factor in factors] for day in dates], float)
    correlation = np.eye(len(factors)) if correlation is None else np.array(correlation, float)
    pair = reversion[:, None] + reversion[None, :]

    def covariance(time):
        safe = np.where(pair > 0, pair, 1.0)
        return correlation * np.where(pair > 0, -np.expm1(-pair * time) / safe, time)

    gaps = np.diff(years, prepend=0.0)
    decay = np.exp(-reversion * gaps[:, None])
    shock = np.array(
        [np.linalg.cholesky(covariance(gap)) if gap > 0 else 0 * correlation for gap in gaps]
    )
    variance = np.array([s @ covariance(t) @ s for s, t in zip(loading, years, strict=True)])
    return GaussianFactors(loading, variance, decay, shock)


def flagship(seasonal: bool = True) -> Schedule:
    """Three-factor storage with ratchets: inputs of the README of the package cmdty-storage."""
    valuation = date("2021-04-25")
    prices = [16.61, 15.68, 15.42, 15.31, 15.27, 15.13, 15.96, 17.22, 17.32, 17.66, 17.59, 16.81]
    nodes = ("2021-04-25", "2021-06-01", "2021-08-01", "2021-12-01", "2022-04-01", "2022-12-01")
    node_days = [(date(node) - valuation).days for node in nodes]
    zero_rates = [0.005, 0.006, 0.0072, 0.0087, 0.0101, 0.0115]

    def discount(day):
        time = max((day - valuation).days, 0)
        return float(np.exp(-np.interp(time, node_days, zero_rates) * time / 365))

    def settle(day):
        return datetime.date(day.year + day.month // 12, day.month % 12 + 1, 20)

    def season(day):
        return 0.19 / 2 * np.cos(2 * np.pi * (day - date("2021-02-01")).days / 365.25)

    factors = [Factor(91.0, lambda day: 0.85), Factor(0.0, lambda day: 0.30)]
    if seasonal:
        factors.append(Factor(0.0, season))
    return build(
        "2021-04-25",
        "2021-04-01",
        "2022-04-01",
        1500.0,
        lambda day: ([0, 2000, 5000, 7000], [150, 200, 260, 275], [250, 175, 155, 132]),
        (0.0, 7000.0),
        lambda day: [*prices, 15.36][(day.year - 2021) * 12 + day.month - 4],
        factors,
        discount=discount,
        settle=settle,
        costs=(0.01, 0.025),
        end_level=0.0,
    )


def two_level_curve(day) -> float:
    """The curve of the two 16-day cases of the C# and Python tests of cmdty-storage."""
    return 56.6 if day <= date("2019-09-22") else 144.41


def sixteen_days() -> Schedule:
    """Constant rates, no discounting (intrinsic case of the tests of cmdty-storage)."""
    return build(
        "2019-09-15",
        "2019-09-15",
        "2019-10-01",
        50.0,
        lambda day: ([0.0], [14.74], [5.26]),
        (0.0, 1100.74),
        two_level_curve,
        [Factor(5.5, lambda day: 0.9)],
        costs=(0.48, 0.74),
        end_level=0.0,
    )


EARLY = (
    [0, 100, 300, 600, 800, 1000],
    [44.85, 45.01, 45.78, 46.17, 46.99, 47.12],
    [56.8, 54.5, 52.01, 51.9, 50.8, 50.01],
)
LATE = (
    [0, 100, 300, 600, 800, 1000],
    [31.41, 31.85, 31.68, 32.78, 33.05, 34.80],
    [48.33, 43.05, 41.22, 40.08, 39.74, 38.51],
)


def dated_ratchets(interpolation: str = "linear") -> Schedule:
    """One factor with ratchets that change on 2019-09-20 (trinomial tests of cmdty-storage)."""
    valuation = date("2019-09-15")
    volatility = [0.975, 0.97, 0.96, 0.91, 0.89, 0.895, 0.891, 0.89, 0.875]
    volatility += [0.872, 0.871, 0.870, 0.869, 0.868, 0.867, 0.866, 0.8655]
    return build(
        "2019-09-15",
        "2019-09-15",
        "2019-10-01",
        50.0,
        lambda day: EARLY if day <= date("2019-09-19") else LATE,
        (0.0, 1000.0),
        two_level_curve,
        [Factor(5.5, lambda day: volatility[(day - valuation).days])],
        discount=lambda day: float(np.exp(-0.025 * max((day - valuation).days, 0) / 365)),
        settle=lambda day: date("2019-10-20"),
        costs=(0.48, 0.74),
        end_level=0.0,
        interpolation=interpolation,
    )


def slow_storage() -> Schedule:
    """Boogert and de Jong, "Gas storage valuation using a multifactor price process", 2011."""
    prices = [26, 25, 23, 22, 21.5, 21, 20.8, 20.7, 22, 23, 24, 25.5]
    return build(
        "2009-04-01",
        "2009-04-01",
        "2010-04-01",
        0.0,
        lambda day: ([0.0], [1.0], [1.0]),
        (0.0, 100.0),
        lambda day: prices[(day.month - 4) % 12],
        [Factor(46.659181, lambda day: 1.0645537)],
        end_level=0.0,
    )


def three_percent(start: str):
    """Discount factors at a continuous rate of 3 %."""
    return lambda day: float(np.exp(-0.03 * (day - date(start)).days / 365))


def large_store(end: str = "2027-04-01") -> Schedule:
    """Far larger than a year of its flows can fill."""
    prices = [27, 26, 25, 24.5, 24.5, 25.5, 28, 31, 33, 34, 33, 30]
    return build(
        "2026-04-01",
        "2026-04-01",
        end,
        0.0,
        lambda day: ([0.0], [230.0], [230.0]),
        (0.0, 500_000.0),
        lambda day: prices[(day.month - 4) % 12],
        [Factor(30.0, lambda day: 1.0)],
        discount=three_percent("2026-04-01"),
        costs=(0.1, 0.1),
        end_level=0.0,
    )


def swing_as_store(least: float, end: str = "2027-10-01", left=(0.0, 100.0), held=300.0):
    """Case D3 of the desk as a store that is emptied; `least`: of every day."""
    prices = [28, 31, 34, 36, 35, 31, 27, 25, 24, 24, 25, 26]
    return build(
        "2026-10-01",
        "2026-10-01",
        end,
        held,
        lambda day: ([0.0], [1.0], [0.0]),
        (0.0, held),
        lambda day: prices[(day.month - 10) % 12],
        [Factor(12.0, lambda day: 0.9)],
        discount=three_percent("2026-10-01"),
        costs=(0.0, 29.0),
        end_level=left,
        min_withdrawal=least,
    )


SINE_VALUATION = date("2019-08-29")


def sine_curve(day) -> float:
    return 53.5 + 24.6 * np.sin(2 * np.pi * (day - SINE_VALUATION).days / 365)


def sine_volatility(day) -> float:
    return 0.78 + 0.35 * np.sin(2 * np.pi * (day - SINE_VALUATION).days / 365)


def nine_percent(day) -> float:
    return float(np.exp(-0.09 * max((day - SINE_VALUATION).days, 0) / 365))


# Day: (volume, unit cost, day on which gas and cost are paid).
CALLS = {
    date("2019-12-15"): (1200.0, 77.08446, date("2020-01-20")),
    date("2020-01-20"): (800.0, 70.63600, date("2020-02-18")),
    date("2020-03-31"): (900.0, 43.24404, date("2020-04-22")),
}


def calls(factors=None, correlation=None) -> Schedule:
    """Gas that may leave on three days only (call option tests of cmdty-storage)."""
    dates = [SINE_VALUATION + datetime.timedelta(n) for n in range(216)]
    paid = {day: terms[2] for day, terms in CALLS.items()}
    return build(
        "2019-08-29",
        "2019-08-29",
        "2020-04-01",
        2900.0,
        lambda day: ([0.0], [CALLS.get(day, (0.0,))[0]], [0.0]),
        (0.0, 2900.0),
        sine_curve,
        factors or [Factor(16.5, sine_volatility)],
        correlation=correlation,
        discount=nine_percent,
        settle=lambda day: paid.get(day, day),
        withdrawal_cost=[CALLS[day][1] if day in CALLS else 0.0 for day in dates],
        withdrawal_cost_discount=[nine_percent(paid.get(day, day)) for day in dates],
    )


def forced_flows() -> Schedule:
    """Twenty days of forced injection, fifteen of forced withdrawal (tests of cmdty-storage)."""
    dates = [SINE_VALUATION + datetime.timedelta(n) for n in range(216)]
    settle = {12: date("2020-01-20"), 1: date("2020-02-18"), 2: date("2020-03-21")}
    into = np.array([0 <= (day - date("2019-12-20")).days < 20 for day in dates]) * 211.5
    out = np.array([0 <= (day - date("2020-02-05")).days < 15 for day in dates]) * 187.54
    by_day = dict(zip(dates, zip(out, into, strict=True), strict=True))
    return build(
        "2019-08-29",
        "2019-08-29",
        "2020-04-01",
        5000.0,
        lambda day: ([0.0], [by_day[day][0]], [by_day[day][1]]),
        (0.0, 10000.0),
        sine_curve,
        [Factor(16.5, sine_volatility)],
        discount=nine_percent,
        settle=lambda day: settle.get(day.month, day),
        costs=(1.23, 0.98),
        injection_cost_discount=[nine_percent(day + datetime.timedelta(10)) for day in dates],
        withdrawal_cost_discount=[nine_percent(day + datetime.timedelta(4)) for day in dates],
        injection_fuel=0.01,
        withdrawal_fuel=0.015,
        min_injection=into,
        min_withdrawal=out,
    )
