"""Flows of a battery that are fixed at auctions, a block of hours at a time."""

import datetime
from itertools import product
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from tests.domains.energy.energy_cases import (
    HOME,
    battery,
    battery_with_prices,
    best_plan,
    case_at,
    exact,
)
from tests.domains.gas_storage.references.linear_program import black_call

from snapo.case.error import CaseError
from snapo.domains.energy.methods.lattice import refined
from snapo.domains.energy.read.auction import auction_of
from snapo.domains.energy.setup import bare_problem, factors_of

DAY = {"end": datetime.datetime(2026, 5, 5)}
SPEED, VOLATILITY, HOUR = 525.6, 10.2956, 1 / 8760  # of the template
FIRST = 24  # hours from the valuation date to the first decision of `with_curve`


def with_curve(folder, prices, **changes):
    """The template from its second day on, with these prices; keys of `[contract]` changed."""
    return battery_with_prices(folder, datetime.datetime(2026, 5, 5), prices, **changes)


def by_lattice(case):
    """The value, and the error of its grids."""
    problem = bare_problem(case)
    return refined(case.contract.layout, problem.schedule, factors_of(problem))


def variance(hours):
    """Of the factor after a time."""
    return -np.expm1(-2 * SPEED * hours * HOUR) / (2 * SPEED)


def loading_after(hours):
    """The share of the factor that an hour keeps, so long after the auction."""
    return VOLATILITY * np.exp(-SPEED * hours * HOUR)


@pytest.mark.prove
def test_hours_are_worth_calls_on_their_forward_prices_at_the_auction(tmp_path):
    """A full store that is never filled again sells in one hour of each block: Black's call, with
    the deviation of ln F(auction, hour)."""
    prices, strike, at = np.ones(9), 95.0, np.array([2, 4, 6])
    prices[at] = 100.0, 90.0, 97.0
    keys = {
        "energy": 3.0, "stored": 3.0, "wear": strike, "auction": {"step": "3h"},
        "charge": {"power": 1000.0, "efficiency": 0.001},
        "discharge": {"power": 1.0, "efficiency": 1.0},
    }  # fmt: skip
    value = exact(with_curve(tmp_path, prices, **keys), finer=8)
    after = at % 3
    deviation = loading_after(after) * np.sqrt(variance(FIRST + at - after))
    calls = [black_call(*x, 1.0).value for x in zip(prices[at], [strike] * 3, deviation)]
    # A corner between two of 401 nodes of the factor costs up to 0.001 of a call.
    assert value == pytest.approx(sum(map(float, calls)), rel=5e-5)


def test_every_schedule_of_two_blocks(tmp_path):
    """All schedules of full hours, compared on a fine grid of the factor at both auctions."""
    prices, hours = np.array([60.0, 45.0, 66.0, 58.0, 70.0, 50.0]), np.arange(3)
    keys = {
        "energy": 1.0, "auction": {"step": "3h"},
        "charge": {"power": 1.0 / 0.9, "efficiency": 0.9},
    }  # fmt: skip
    result = by_lattice(with_curve(tmp_path, prices, **keys))

    f = np.linspace(-1, 1, 2001) * 7 * np.sqrt(variance(FIRST + 3))

    def best(block, after):
        """[2, nodes] from each state of the store; `after` that a block later."""
        at, loading = FIRST + 3 * block, loading_after(hours)[:, None]
        price = prices[3 * block + hours, None] * np.exp(
            loading * f - loading**2 * variance(at) / 2
        )
        value = np.full((2, len(f)), -np.inf)
        for state, flows in product((0, 1), product((-1, 0, 1), repeat=3)):
            stored = state + np.cumsum(flows)
            if stored.min() >= 0 and stored.max() <= 1:
                money = sum(
                    -x / 0.9 if q > 0 else (0.95 * x - 3.0) * -q for q, x in zip(flows, price)
                )
                value[state] = np.maximum(value[state], money + after[stored[-1]])
        return value

    def density(mean, spread):
        weight = np.exp(-0.5 * ((f[None, :] - mean[:, None]) / spread) ** 2)
        return weight / weight.sum(axis=1, keepdims=True)

    left = np.exp(-SPEED * 3 * HOUR)
    second = best(1, np.zeros((2, len(f)))) @ density(left * f, np.sqrt(variance(3))).T
    value = best(0, second)[0] @ density(np.zeros(1), np.sqrt(variance(FIRST)))[0]
    assert result.value == pytest.approx(float(value), rel=2e-5)


def test_auctions_of_every_hour_are_none():
    assert exact(battery(**DAY, auction={"step": "1h"})) == pytest.approx(
        exact(battery(**DAY)), rel=1e-9
    )


@pytest.mark.prove
def test_less_is_known_at_earlier_auctions():
    """Each auction of a longer step is one of the shorter one too, and is on the valuation date
    before all hours of the first day."""
    none, *values = (exact(battery(**DAY, auction=x))
                     for x in (None, *({"step": step} for step in ("2h", "4h", "12h"))))  # fmt: skip
    assert none > values[0] > values[1] > values[2] > exact(battery(**DAY), forward=True)
    whole = exact(battery(**DAY, auction={"step": "24h"}))
    assert whole == pytest.approx(exact(battery(**DAY), forward=True), rel=1e-12)


def test_without_volatility_it_is_the_best_plan():
    """A linear program."""
    keys = {"contract.end": DAY["end"], "contract.auction": {"step": "4h"}}
    case = case_at(HOME / "template_battery", keys | {"model.volatility": 0.0})
    assert exact(case) == pytest.approx(best_plan(case), rel=1e-6)


def blocks(start, hours, at, step, zone="Europe/Berlin"):
    """Local times of the hours of each auction."""
    zone = ZoneInfo(zone)
    first = datetime.datetime.fromisoformat(start).replace(tzinfo=zone).astimezone(datetime.UTC)
    result: dict[datetime.datetime, list[str]] = {}
    for n in range(hours):
        instant = first + datetime.timedelta(hours=n)
        auction = auction_of(instant, zone, at, step)
        assert auction <= instant
        result.setdefault(auction, []).append(f"{instant.astimezone(zone):%H}")
    return list(result.values())


def test_blocks_follow_the_local_clock():
    assert [len(x) for x in blocks("2026-05-04T00:00", 24, 0, 4)] == [4] * 6
    assert [len(x) for x in blocks("2026-03-29T00:00", 23, 0, 4)] == [3, 4, 4, 4, 4, 4]
    assert [len(x) for x in blocks("2026-10-25T00:00", 25, 0, 24)] == [25]
    assert blocks("2026-05-04T09:00", 26, 10, 24)[0] == ["09"]
    assert blocks("2026-05-04T09:00", 26, 10, 24)[1][-1] == "09"
    # Hours that the clock skips, or shows twice.
    assert blocks("2026-03-29T01:00", 4, 2, 4)[:2] == [["01"], ["03", "04", "05"]]
    assert blocks("2026-10-25T01:00", 4, 1, 1) == [["01"], ["02"], ["02"], ["03"]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contract.auction": {"at": "00:30", "step": "4h"}}, "auction.at: got '00:30'; it must be a full hour"),
        ({"contract.auction": {"step": "5h"}}, "auction.step: got '5h'; it must be .1h., .2h"),
        ({"contract.auction": {"at": "00:00"}}, "auction.step"),
        ({"contract.auction": {"step": "4h"}, "objective": {"kind": "cvar", "level": 0.1}},
         'the objective must be "mean"'),
    ],
)  # fmt: skip
def test_mistakes_of_auctions_are_named(changes, message):
    with pytest.raises(CaseError, match=message):
        case_at(HOME / "template_battery", changes)
