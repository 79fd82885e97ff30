"""The factors on the first date have the same law in simulated paths as in dynamic programs."""

import datetime

import numpy as np
import pytest
from tests.domains.energy.energy_cases import battery, swing
from tests.domains.gas_storage.storage_cases import read
from tests.lanes.in_numpy import in_numpy

from snapo.domains.energy.setup import bare_problem as bare_energy_problem
from snapo.domains.gas_storage.contract.records import storage_inputs

VALUATION = datetime.date(2024, 12, 2)
FACTORS = [{"mean_reversion": 20.0, "volatility": 0.9}, {"mean_reversion": 1.0, "volatility": 0.3}]
MODELS = (
    {"kind": "one-factor"},
    {"kind": "one-factor-normal", "volatility": 20.0},
    {"kind": "one-factor-shifted", "shift": 5.0},
    {
        "kind": "multi-factor", "factors": FACTORS, "correlation": [[1.0, 0.4], [0.4, 1.0]],
        "mean_reversion": None, "volatility": None,
    },
    {
        "kind": "three-factor-seasonal", "spot_mean_reversion": 20.0, "spot_volatility": 0.9,
        "long_term_volatility": 0.3, "seasonal_volatility": 0.2,
        "mean_reversion": None, "volatility": None,
    },
)  # fmt: skip
NOMINATIONS = (
    None,
    {"days": 1, "calendar": "every-day"},
    {"days": 1, "calendar": "business"},
    {"days": 2, "calendar": "business", "holidays": [datetime.date(2025, 1, 6)]},
)


def covariances(price):
    """The covariance of the factors on the first date: in simulated paths, and in closed form."""
    before, first = np.asarray(price.before), np.asarray(price.first_shock)
    return before @ before.T, first @ first.T


def prepared(case):
    """The schedule of the prices of a store."""
    values = {name: entry.value for name, entry in storage_inputs(case).items()}
    return in_numpy(case.model.prepare)(values)


def store(first: int, nomination, model=MODELS[0]):
    start = datetime.date(2025, 1, first)
    return read(
        "quick", contract={"start": start, "nomination": nomination}, model=model,
        market={"valuation_date": VALUATION},
    )  # fmt: skip


@pytest.mark.parametrize("first", [5, 6], ids=["Sunday", "Monday"])
def test_a_start_that_is_nominated_on_friday(first):
    """Both are nominated 32 days after the valuation date, (1 - exp(-40 32 / 365)) / 40."""
    case = store(first, NOMINATIONS[2])
    simulated, exact = covariances(prepared(case).constants)
    variance = -np.expm1(-40 * 32 / 365) / 40
    assert simulated[0, 0] == pytest.approx(variance, rel=1e-9)
    assert exact[0, 0] == pytest.approx(variance, rel=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model["kind"])
@pytest.mark.parametrize("nomination", NOMINATIONS, ids=["none", "day", "business", "holiday"])
def test_every_price_and_calendar(nomination, model):
    for first in (4, 5, 6, 7):
        prices = prepared(store(first, nomination, model))
        simulated, exact = covariances(prices.constants)
        assert simulated == pytest.approx(exact, rel=1e-9)
        loading, variance = prices.steps.loading[0], prices.steps.variance[0]
        assert loading @ simulated @ loading == pytest.approx(variance, rel=1e-9)


@pytest.mark.parametrize("step", [None, "1h", "4h", "24h"])
def test_a_battery_with_auctions(step):
    auction = None if step is None else {"step": step}
    case = battery(start=datetime.datetime(2026, 5, 5, 3), auction=auction, cycles=None)
    simulated, exact = covariances(bare_energy_problem(case).schedule.constants.price)
    assert simulated == pytest.approx(exact, rel=1e-9)
    assert exact[0, 0] > 0


def test_a_month_ahead_index():
    """Its factor on the first date has the variance of the price factor on the fixing date."""
    case = swing(strike={"index": "month-ahead"}, start=datetime.date(2026, 12, 1), annual=None)
    price = bare_energy_problem(case).schedule.constants.price
    assert float((np.asarray(price.before) ** 2).sum()) == pytest.approx(price.first[0], rel=1e-9)
    assert price.first[0] > 0
