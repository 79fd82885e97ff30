"""Estimates and hedges inside a back-test: no foresight, the value on average, the spread exactly."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from tests.domains.gas_storage.history.test_backtest import DATA, FILE, FIRST, ONE, market
from tests.domains.gas_storage.storage_cases import CASES

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.cli.main import main
from snapo.domains.gas_storage.history.backtest import backtest, run_backtest
from snapo.domains.gas_storage.history.hedged import change_deviation
from snapo.domains.gas_storage.history.maximum import fit
from snapo.domains.gas_storage.history.observed import ForwardQuote as Quote
from snapo.domains.gas_storage.history.observed import ObservedMarket
from snapo.domains.gas_storage.history.read import read_calibration
from snapo.domains.gas_storage.history.recalibrate import ModelHistory
from snapo.domains.gas_storage.history.rule import DatedRule, drawn_spots, solved_on
from snapo.domains.gas_storage.history.table import BacktestPlan, plan_of
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.references.lattice import refined
from snapo.domains.gas_storage.setup import factors

HEDGE = {"deltas": [["balance_of_month", "day_ahead"]], "least_variance": [["day_ahead"]]}
TWO = [{"mean_reversion": 20.0, "volatility": 0.9}, {"mean_reversion": 0.0, "volatility": 0.4}]
MODEL = {"kind": "multi-factor", "factors": TWO, "correlation": [[1.0, 0.3], [0.3, 1.0]]}


def ruled(**tables) -> tuple[dict, DatedRule]:
    """The small store with other tables, hedged by 2,048 paths, and its rule."""
    data = DATA | {"hedge": HEDGE | {"paths": 2048}} | tables
    return data, solved_on(FILE, data, None, None, None)


def earlier(seen: ObservedMarket, count: int = 300) -> ObservedMarket:
    """With spot prices of the model before the valuation date."""
    random, x, prices = np.random.default_rng(7), 0.0, []
    for _ in range(count):
        x = np.exp(-20 / 365) * x + 0.9 / np.sqrt(365) * random.standard_normal()
        prices.append(20.0 * float(np.exp(x)))
    days = tuple(FIRST - (count - n) * ONE for n in range(count))
    spots = (*days, *seen.spot_days), (*prices, *seen.spot_prices)
    return replace(seen, spot_days=spots[0], spot_prices=spots[1])


def curves_of(rule: DatedRule, states: np.ndarray) -> ObservedMarket:
    """Spot prices and daily curves of one path of the factors [T + 1, F]."""
    assert rule.prices is not None
    paths = PathCurves(rule.prices.factors, rule.prices.forward, states[:, :, None])
    days, curves = rule.case.days, {}
    for t, day in enumerate(days):
        prices = paths(t)[: len(days) - t, 0].tolist()
        curves[day] = [Quote(day + i * ONE, day + i * ONE, x) for i, x in enumerate(prices)]
    return ObservedMarket(Path(), days, tuple(paths.spots[:-1, 0].tolist()), days, curves)


def results(rule: DatedRule, data: dict, histories, **options) -> tuple[np.ndarray, np.ndarray]:
    """[n] the money of the contract, and [n, hedges] that with each hedge."""
    runs = [run_backtest(FILE, data, seen, rule, hedge=True, **options) for seen in histories]
    return np.array([x.realised for x in runs]), np.array(
        [[hedge.total for hedge in x.hedges] for x in runs]
    )


def is_mean(money: np.ndarray, value: float) -> bool:
    return abs(money.mean() - value) < 2 * money.std(ddof=1) / np.sqrt(len(money))


def exact(rule: DatedRule) -> float:
    """By dynamic programming on a lattice."""
    prices, kind = factors(rule.problem), rule.case.contract.ratchets.interpolation
    assert prices is not None
    return refined(jax.tree.map(np.asarray, rule.problem.schedule), prices, kind).value


@pytest.mark.prove
def test_hedges_keep_the_mean_and_take_the_risk():
    """Twelve histories of one factor: the value within two errors, and little of the deviation."""
    data, rule = ruled()
    paths = drawn_spots(rule.problem, 64, 11)
    histories = [market(rule, paths[:, n]) for n in range(12)]
    alone, hedged = results(rule, data, histories, every=99)
    for money in hedged.T:
        assert is_mean(money, exact(rule))
    # A factor is hedged by one product, but for the second order of a day's move.
    assert hedged[:, 1].std() < 0.05 * alone.std()
    assert hedged[:, 0].std() < 0.35 * alone.std()


@pytest.mark.study
@pytest.mark.parametrize(("model", "share"), [(DATA["model"], 0.05), (MODEL, 0.8)])
def test_two_hundred_histories(model, share):
    """Solved again after 15 days, of one factor and of two, which daily curves show."""
    data, rule = ruled(model=model)
    assert rule.prices is not None
    states = drawn_states(rule.prices.factors, 200, 3)
    histories = [curves_of(rule, states[:, :, n]) for n in range(200)]
    alone, hedged = results(rule, data, histories, every=15)
    for money in (alone, *hedged.T):
        assert is_mean(money, exact(rule))
    assert hedged[:, 1].std() < share * alone.std()
    assert hedged[:, 0].std() < 0.35 * alone.std()


@pytest.mark.prove
def test_two_factors_are_seen_on_the_curve():
    """The factors of a day from its spot price and its curve, which two factors make."""
    _, rule = ruled(model=MODEL)
    assert rule.prices is not None
    states, t = drawn_states(rule.prices.factors, 3, 4), 8
    curve = PathCurves(rule.prices.factors, rule.prices.forward, states)(t)
    for n in range(3):
        seen = rule.from_curve(t, np.zeros((1, 2)), float(curve[0, n]), curve[:, n])
        np.testing.assert_allclose(seen[0], states[t, :, n], atol=1e-8)
    # A curve that no factors make: the spot price is met exactly, whatever the curve.
    moved = rule.from_curve(t, np.zeros((1, 2)), 25.0, 1.1 * curve[:, 0])
    again = PathCurves(
        rule.prices.factors, rule.prices.forward, np.repeat(moved[:, :, None], 31, 0)
    )
    assert again.spots[t, 0] == pytest.approx(25.0, rel=1e-12)


@pytest.fixture(scope="module")
def estimated():
    """Estimated every ten days and hedged, on one history with spot prices before it."""
    data, rule = ruled()
    seen = earlier(market(rule, drawn_spots(rule.problem, 4, 5)[:, 3]))
    return data, rule, seen, run_backtest(FILE, data, seen, rule, None, calibrate=10, hedge=True)


@pytest.mark.prove
def test_nothing_sees_what_comes_later(estimated):
    """All prices and curves after day 14 are others: no decision, estimate or position up to it
    moves by a bit."""
    data, rule, seen, before = estimated
    days, last = rule.case.days, 14
    pairs = zip(seen.spot_days, seen.spot_prices)
    spots = tuple(x if day <= days[last] else 0.5 * x for day, x in pairs)
    curves = {
        day: quotes if day <= days[last] else [x._replace(price=1.5 * x.price) for x in quotes]
        for day, quotes in seen.curves.items()
    }
    other = replace(seen, spot_prices=spots, curves=curves)
    after = run_backtest(FILE, data, other, rule, None, calibrate=10, hedge=True)
    for name in ("inventory", "cash"):
        one, two = (getattr(x, name)[: last + 1].tobytes() for x in (before, after))
        assert one == two, name
    assert [x.date for x in before.estimates] == [days[0], days[10], days[20]]
    assert before.estimates[:2] == after.estimates[:2] and before.marks[:2] == after.marks[:2]
    assert before.estimates[2] != after.estimates[2]
    for name in ("positions", "hedge_days"):
        one, two = ([x for x in getattr(run, name) if x.date <= days[last]]
                    for run in (before, after))  # fmt: skip
        assert len(one) >= 2 * last and one == two, name
        assert getattr(before, name) != getattr(after, name)


@pytest.mark.prove
def test_estimates_are_those_of_the_command(estimated, tmp_path):
    """`snapo calibrate` on the prices until the day; the case is then solved with them."""
    _, rule, seen, result = estimated
    rows = [f"{day},{float(price)!r}" for day, price in zip(seen.spot_days, seen.spot_prices)]
    (tmp_path / "spot.csv").write_text("\n".join(["date,price", *rows]) + "\n")
    file = tmp_path / "c.toml"
    until = rule.case.days[10]
    file.write_text(
        f'kind = "calibration"\n[history]\nspot = "spot.csv"\nlast = {until}\n'
        '[model]\nkind = "one-factor"\n'
    )
    estimate, direct = result.estimates[1], fit(read_calibration(file)).estimate
    assert estimate.date == until and estimate.prices == 311 and not estimate.reason
    assert [x.estimate for x in estimate.parameters] == direct.numbers.tolist()
    assert [x.high for x in estimate.parameters] == direct.high.tolist()
    truth = {"mean_reversion": 20.0, "volatility": 0.9}
    for row in estimate.parameters[:2]:
        assert row.low < truth[row.parameter] < row.high
    assert estimate.model["volatility"] == pytest.approx(direct.numbers[1], rel=1e-7)
    assert estimate.model["kind"] == "one-factor"


@pytest.mark.prove
def test_the_last_model_is_kept(estimated):
    """Where the history does not determine a parameter, and where it is too short."""
    data, _, seen, _ = estimated
    for window, reason in ((30, "does not determine mean_reversion"), (None, "need at least 20")):
        models = ModelHistory(FILE, data, seen, BacktestPlan("month", window))
        day = FIRST if window else seen.spot_days[10]
        estimate = models.estimate(day)
        assert reason in estimate.reason, estimate
        assert estimate.model == data["model"] and models.data == data
        assert estimate.prices == (30 if window else 11)


@pytest.mark.prove
def test_a_spread_costs_its_half_for_each_unit_traded():
    """Without interest, exactly; trades and gains are the same, in lots."""
    runs, lot = [], 0.25
    for spread in (0.0, 0.2):
        products = {
            "day_ahead": {"bid_offer": spread},
            "balance_of_month": {"bid_offer": spread, "lot": lot},
        }
        market_table = DATA["market"] | {"interest_rate": 0.0}
        data, rule = ruled(products=products, market=market_table)
        seen = market(rule, drawn_spots(rule.problem, 4, 5)[:, 3])
        runs.append(run_backtest(FILE, data, seen, rule, 99, hedge=True))
    free, paid = runs
    assert free.positions == paid.positions and free.realised == paid.realised
    for one, two in zip(free.hedges, paid.hedges, strict=True):
        assert one.traded == two.traded > 0 and one.cost == 0.0
        assert two.cost == pytest.approx(0.1 * two.traded, rel=1e-12)
        assert one.gain - two.gain == pytest.approx(two.cost, rel=1e-9)
        assert two.total == pytest.approx(paid.realised + two.gain, rel=1e-12)
    lots = [x.sold / lot for x in paid.positions if x.product.startswith("balance")]
    assert lots and all(x == round(x) for x in lots)


@pytest.mark.prove
def test_positions_wait_for_the_next_curve():
    """Without curves from the 10th to the 12th nothing trades there, and positions are held."""
    data, rule = ruled()
    seen = market(rule, drawn_spots(rule.problem, 4, 5)[:, 3])
    gap = [FIRST + n * ONE for n in (9, 10, 11)]
    curves = {day: quotes for day, quotes in seen.curves.items() if day not in gap}
    seen = replace(seen, curve_days=tuple(curves), curves=curves)
    result = run_backtest(FILE, data, seen, rule, 99, hedge=True)
    assert not {x.date for x in result.positions} & set(gap)
    quiet = [x for x in result.hedge_days if x.date in gap]
    assert len(quiet) == 6 and all(x.traded == x.cost == 0.0 for x in quiet)
    balance = [x for x in quiet if x.products == "day ahead, balance of month"]
    assert any(x.gain for x in balance)
    # The day-ahead of the 9th has been delivered on the 10th: nothing is held on the next days.
    last = [x.gain for x in result.hedge_days if x.products == "day ahead"]
    assert last[9] != 0.0 and last[10:13] == [0.0, 0.0, 0.0] and last[13] != 0.0
    for hedge in result.hedges:
        days = [x for x in result.hedge_days if x.products == hedge.products]
        assert sum(x.gain - x.cost for x in days) == pytest.approx(hedge.gain, rel=1e-9)


@pytest.mark.prove
def test_a_hedge_begins_on_the_valuation_date():
    """Two days before the first flow the deltas of the day are sold, in the month."""
    early, free = FIRST - 2 * ONE, {"injection_cost": 0.0, "withdrawal_cost": 0.0}
    times = {"valuation_date": early, "interest_rate": 0.0}
    data, rule = ruled(market=DATA["market"] | times, contract=DATA["contract"] | free)
    assert rule.prices is not None
    seen = curves_of(rule, drawn_states(rule.prices.factors, 2, 3)[:, :, 0])
    days, prices = rule.case.days, rule.prices.forward[:30].tolist()
    today = [Quote(day, day, price) for day, price in zip(days, prices)]
    curves = {early: today} | dict(seen.curves)
    seen = replace(seen, spot_days=(early, *days), spot_prices=(20.0, *seen.spot_prices),
                   curve_days=tuple(curves), curves=curves)  # fmt: skip
    products = {"months": {"last_trading": 0}, "balance_of_month": {}, "day_ahead": {}}
    data = data | {
        "products": products,
        "hedge": {"deltas": [list(products)], "least_variance": [], "paths": 2048},
    }
    result = run_backtest(FILE, data, seen, solved_on(FILE, data, None, None, None), 99, hedge=True)
    sold = [x for x in result.positions if x.date == early]
    assert [x.product for x in sold] == ["2025-01"] and result.hedge_days[0].date == early
    assert (sold[0].first, sold[0].last) == (days[0], days[-1]) and result.hedge_days[0].gain == 0.0
    # Without costs the value is the sum of its deltas times their prices (Euler): 2,048 paths.
    assert (
        abs(30 * sold[0].sold * sold[0].price - result.expected) < 3 * result.deviation / 2048**0.5
    )
    assert result.hedge_days[1].gain != 0.0


def test_when_the_model_is_estimated():
    days = [FIRST + n * ONE for n in range(100)]
    assert BacktestPlan().due(days) == frozenset()
    assert sorted(BacktestPlan("month").due(days[10:])) == [0, 21, 49, 80]
    assert sorted(BacktestPlan("quarter").due(days)) == [0, 90]
    assert sorted(BacktestPlan("year").due(days)) == [0]
    assert sorted(BacktestPlan(40).due(days)) == [0, 40, 80]
    plan = plan_of(FILE, {"calibrate": "month", "window": 730, "season": 1}, [])
    assert plan == BacktestPlan("month", 730, "spot", 1)
    assert np.isnan(change_deviation([1.0, 2.0]))
    assert change_deviation([1.0, 2.0, 5.0]) == pytest.approx(np.sqrt(2.0))


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({"calibrate": "week"}, ["backtest.calibrate", "'week'", '"month"', "number of days"]),
        ({"calibrate": 0}, ["backtest.calibrate", "0", "number of days"]),
        ({"calibrate": True}, ["backtest.calibrate", "number of days"]),
        ({"window": 5}, ["backtest.window", "5", "30"]),
        ({"prices": "curves"}, ["backtest.prices", "'curves'", "spot and curves"]),
    ],
)
def test_a_wrong_key_is_named(table, named):
    with pytest.raises(CaseError) as caught:
        plan_of(FILE, table, [])
    for name in named:
        assert name in str(caught.value), caught.value


@pytest.mark.prove
def test_what_cannot_be_estimated_or_hedged_is_refused(tmp_path):
    """A model without a likelihood; a folder without curves."""
    data, rule = ruled()
    seen = market(rule, drawn_spots(rule.problem, 4, 5)[:, 3])
    spikes = {"kind": "one-factor-jumps", "mean_reversion": 12.0, "volatility": 0.6}
    with pytest.raises(CaseError, match="one-factor-jumps"):
        ModelHistory(FILE, data | {"model": spikes}, seen, BacktestPlan("month"))
    bare = replace(seen, curve_days=(), curves={})
    for calibrate, hedge in (("month", False), ("never", True)):
        with pytest.raises(CaseError, match=r"curves\.csv.*2025-01-01"):
            run_backtest(FILE, data, bare, rule, None, calibrate=calibrate, hedge=hedge)


@pytest.mark.prove
def test_the_command_writes_hedges_and_estimates(tmp_path, capsys):
    """Too few prices before the contract: the model of the case is kept, and the report says so."""
    case = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    rule = solved_on(*load(case), None, None, None)
    seen = market(rule, drawn_spots(rule.problem, 4, 5)[:, 3])
    rows = [f"{day},{float(price)!r}" for day, price in zip(seen.spot_days, seen.spot_prices)]
    (tmp_path / "spot.csv").write_text("\n".join(["date,price", *rows]) + "\n")
    quotes = [
        f"{day},{x.first},{float(x.price)!r}" for day, row in seen.curves.items() for x in row
    ]
    (tmp_path / "curves.csv").write_text("\n".join(["date,product,price", *quotes]) + "\n")
    options = ["backtest", str(case), "--history", str(tmp_path), "--calibrate", "month", "--hedge"]
    assert main([*options, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    (estimate,) = answer["estimates"]
    assert "20 dates" in estimate["reason"] and estimate["date"] == "2025-01-01"
    products = [x["products"] for x in answer["hedges"]]
    assert "day ahead, balance of month" in " ".join(products) and answer["mark_deviation"] is None
    folder = case / "backtest"
    heads = {name: (folder / f"{name}.csv").read_text().splitlines() for name in
             ("hedges", "hedge_days", "hedge_positions", "calibrations")}  # fmt: skip
    assert len(heads["hedges"]) == 1 + len(products)
    assert len(heads["hedge_days"]) == 1 + 30 * len(products)
    assert heads["calibrations"][0].startswith("date,prices,used,reason,parameter,estimate")
    assert heads["calibrations"][1].startswith("2025-01-01,1,no,")
    result = backtest(case, tmp_path, lambda text: None, calibrate="never", hedge=True)
    assert result["hedges"] == answer["hedges"] and result["estimates"] == []
    assert main(options) == 0
    printed = capsys.readouterr().out
    assert "the previous model is used" in printed and "deviation" in printed


def test_dates_of_estimates_are_options(capsys):
    with pytest.raises(SystemExit):
        main(["backtest", "x", "--history", "y", "--calibrate", "week"])
    assert (
        "'week' is not never, month, quarter, year or a number of days" in capsys.readouterr().err
    )
