"""`snapo backtest`: no decision sees the future, and the mean over simulated histories is the value."""

import datetime
import json
import shutil
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.cli.main import main
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.history.backtest import (
    DrawnHistories,
    StoreBacktest,
    run_backtest,
)
from snapo.domains.gas_storage.history.observed import ForwardQuote as Quote
from snapo.domains.gas_storage.history.observed import ObservedMarket, read_observed
from snapo.domains.gas_storage.history.read import read_calibration
from snapo.domains.gas_storage.history.rule import drawn_spots, followed, solved_on
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.products import usual_products
from snapo.domains.gas_storage.ladder.rolling import Chains, rolling
from snapo.domains.gas_storage.ladder.store import FlatStore
from snapo.domains.gas_storage.references.lattice import refined
from snapo.domains.gas_storage.setup import factors
from snapo.problem.carry.save import load as load_policy
from snapo.problem.policy import Policy

FILE, DATA = load(CASES / "quick")
FIRST = datetime.date(2025, 1, 1)
ONE = datetime.timedelta(1)


@pytest.fixture(scope="module")
def ledger():
    """Thirty days of a small store."""
    return solved_on(FILE, DATA, None, None, None)


def market(ledger, path: np.ndarray) -> ObservedMarket:
    """Spot prices of a path, and the curve of the one-factor model around each of them."""
    days, steps = ledger.case.days, ledger.problem.schedule.steps
    forward, a, s = np.asarray(steps.forward), 20.0, 0.9
    years = np.arange(30) / 365
    variance = s**2 * (1 - np.exp(-2 * a * years)) / (2 * a)
    moved = np.log(path[:30] / forward) + variance / 2
    curves = {}
    for t, day in enumerate(days):
        decay = np.exp(-a * (years[t:] - years[t]))
        prices = forward[t:] * np.exp(decay * moved[t] - decay**2 * variance[t] / 2)
        curves[day] = [Quote(day + i * ONE, day + i * ONE, x) for i, x in enumerate(prices)]
    return ObservedMarket(Path(), days, tuple(path[:30]), days, curves)


@pytest.fixture(scope="module")
def paths(ledger) -> np.ndarray:
    return drawn_spots(ledger.problem, 16384, 5)


@pytest.fixture(scope="module")
def runs(ledger, paths) -> tuple[StoreBacktest, StoreBacktest, ObservedMarket]:
    """Solved every 12 days, and never again after the first time, on the curves of one path."""
    seen = market(ledger, paths[:, 3])
    often = run_backtest(FILE, DATA, seen, ledger, 12)
    return often, run_backtest(FILE, DATA, seen, ledger, 99), seen


@pytest.mark.prove
def test_the_mean_over_drawn_histories_is_the_value(ledger, paths):
    """Of 16,384 histories of the model; the value by dynamic programming on a lattice."""
    money = followed(ledger, paths).money
    error = money.std(ddof=1) / np.sqrt(len(money))
    problem, kind = ledger.problem, ledger.case.contract.ratchets.interpolation
    prices = factors(problem)
    assert prices is not None
    exact = refined(jax.tree.map(np.asarray, problem.schedule), prices, kind).value
    assert abs(money.mean() - exact) < 2 * error
    assert error < 0.005 * exact


@pytest.mark.prove
def test_no_decision_sees_what_comes_later(ledger, runs):
    """All prices and curves after day 14 are others: nothing up to it moves by a bit."""
    often, _, seen = runs
    days, last = ledger.case.days, 14
    spots = tuple(x if t <= last else 0.5 * x for t, x in enumerate(seen.spot_prices))
    curves = {
        day: quotes if day <= days[last] else [x._replace(price=1.5 * x.price) for x in quotes]
        for day, quotes in seen.curves.items()
    }
    other = ObservedMarket(Path(), days, spots, days, curves)
    moved = run_backtest(FILE, DATA, other, ledger, 12)
    assert [mark.date for mark in moved.marks] == [days[0], days[12], days[24]]
    for name in ("inventory", "injection", "withdrawal", "cash", "expected_cash"):
        before, after = (getattr(x, name)[: last + 1].tobytes() for x in (often, moved))
        assert before == after, name
    assert often.marks[:2] == moved.marks[:2]
    assert not np.array_equal(often.inventory[last + 1 :], moved.inventory[last + 1 :])


@pytest.mark.prove
def test_curves_of_the_model_change_no_decision(ledger, runs, paths):
    """Around a later curve of the model its problem is the same one: so are the decisions."""
    often, once, _ = runs
    np.testing.assert_allclose(often.inventory, once.inventory, atol=0.2)
    np.testing.assert_allclose(often.realised, once.realised, rtol=2e-3)
    # The same path without any curve, of one solution on the forward prices of the case.
    assert followed(ledger, paths[:, 3:4]).money[0] == pytest.approx(once.realised, abs=1e-6)
    # Marked to the curve: cash so far and what is to come; at first it is what is expected.
    assert often.marks[0].expected == pytest.approx(often.expected, rel=1e-12)
    for mark in often.marks:
        assert mark.expected + 3 * mark.standard_error > mark.intrinsic
    assert often.cash.sum() == pytest.approx(often.realised, abs=1e-9)  # nothing is left
    assert often.rolling is not None and often.marks[0].intrinsic <= often.expected


@pytest.mark.prove
def test_factors_are_their_mean_given_the_spot_prices():
    """Two factors, against the regression of the factors on all prices until the day."""
    two = {"mean_reversion": 20.0, "volatility": 0.9}, {"mean_reversion": 0.5, "volatility": 0.4}
    model = {"kind": "multi-factor", "factors": list(two), "correlation": [[1.0, 0.3], [0.3, 1.0]]}
    rule = solved_on(FILE, DATA | {"model": model}, None, None, None)
    prices, count, t = factors(rule.problem), 64, 8
    assert rule.filter is not None and prices is not None
    states = drawn_states(prices, count, 4)
    moved = np.einsum("tf,tfn->tn", prices.loading, states)
    mean = rule.initial_factors(count).T
    for gain, decay, loading, y in zip(*rule.filter, prices.loading[: t + 1], moved):
        mean = decay[:, None] * mean
        mean = mean + gain[:, None] * (y - loading @ mean)
    # Cov(f(t), y(s)) and Cov(y(s), y(u)) for days 1 to t; on the valuation date all is zero.
    a, rho = np.array([20.0, 0.5]), np.array([[1.0, 0.3], [0.3, 1.0]])
    s = np.array([0.9, 0.4])

    def covariance(early: int, late: int) -> np.ndarray:
        """Of f(late) with f(early)."""
        pair = a[:, None] + a[None]
        now = rho * (1 - np.exp(-pair * early / 365)) / pair
        return np.exp(-a * (late - early) / 365)[:, None] * now

    days = range(1, t + 1)
    between = np.array([[s @ covariance(min(u, v), max(u, v)) @ s for u in days] for v in days])
    with_state = np.array([covariance(u, t) @ s for u in days])
    exact = with_state.T @ np.linalg.solve(between, moved[1 : t + 1])
    np.testing.assert_allclose(mean, exact, atol=1e-5)
    # The price of the day is met exactly.
    np.testing.assert_allclose(s @ mean, moved[t], atol=1e-9)


@pytest.mark.prove
def test_rolling_intrinsic_is_that_of_the_ladder(ledger, runs, paths):
    """On the curves of a path of the factor, which the ladder makes by another formula."""
    schedule = jax.tree.map(np.asarray, ledger.problem.schedule)
    prices = factors(ledger.problem)
    assert prices is not None
    forward = np.append(schedule.steps.forward, schedule.constants.end_forward)
    years = np.arange(31) / 365
    variance = 0.9**2 * (1 - np.exp(-40.0 * years)) / 40.0
    state = (np.log(paths[:, 3] / forward) + variance / 2) / 0.9
    curves = PathCurves(prices, forward, state[:, None, None])
    products = usual_products(ledger.case.days, ledger.case.valuation_date)
    chains = Chains(FlatStore(schedule, ledger.case.contract.ratchets.interpolation))
    money = rolling(chains, products.blocks, curves, 1, products.before).money[0]
    assert runs[0].rolling == pytest.approx(money, rel=1e-9)


@pytest.mark.prove
def test_the_command_writes_its_tables(tmp_path, ledger, paths, capsys):
    case = Path(shutil.copytree(CASES / "quick", tmp_path / "case"))
    prices, days = paths[:30, 3], ledger.case.days
    rows = [f"{day},{price!r}" for day, price in zip(days, prices.tolist()) if day.day != 9]
    (tmp_path / "spot.csv").write_text("\n".join(["date,price", *rows]) + "\n")
    assert main(["backtest", str(case), "--history", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "30 days from 2025-01-01 to 2025-01-30" in printed
    assert f"report: {case / 'backtest' / 'report.html'}" in printed
    page = (case / "backtest" / "report.html").read_text()
    assert "Realised and expected" in page and "Rolling" not in page  # there are no curves
    table = np.genfromtxt(case / "backtest" / "days.csv", delimiter=",", names=True)
    assert len(table) == 30 and table["spot"][8] == table["spot"][7]  # a day without a price
    assert table["inventory"][-1] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(np.cumsum(table["cash"]), table["cash_so_far"])
    realised = f"{table['cash_so_far'][-1]:,.2f}"
    assert realised in next(x for x in printed.splitlines() if x.startswith("realised"))


@pytest.mark.prove
def test_a_trained_policy_decides(solved, tmp_path, ledger, paths, capsys):
    """The policy of a run, here one that values gas more than its start; a folder without one is
    named."""
    folder, days = solved("gas-storage"), ledger.case.days
    run = tmp_path / "trained"
    run.mkdir()
    policy = load_policy(folder / "run" / "policy.npz", Policy, ledger.policy)
    policy = eqx.tree_at(lambda x: x.network.biases[-1], policy, replace_fn=lambda x: x + 0.3)
    policy.save(run / "policy.npz")
    rows = [f"{day},{price!r}" for day, price in zip(days, paths[:30, 3].tolist())]
    (tmp_path / "spot.csv").write_text("\n".join(["date,price", *rows]) + "\n")
    more = ["--history", str(tmp_path), "--out", str(tmp_path / "out"), "--json", "--policy"]
    assert main(["backtest", str(folder / "case"), *more, str(run)]) == 0
    answer = json.loads(capsys.readouterr().out)
    followed_by = followed(replace(ledger, policy=policy), paths[:, 3:4])
    assert answer["realised"] == pytest.approx(followed_by.money[0], rel=1e-9)
    assert abs(answer["realised"] - followed(ledger, paths[:, 3:4]).money[0]) > 1
    assert main(["backtest", str(folder / "case"), *more, str(tmp_path)]) == 2
    assert "policy.npz" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spot", "curves", "named"),
    [
        ("2025-01-01,20\n2025-01-02,-1\n", "", ["spot.csv", "line 3", "price", "-1", "above 0"]),
        ("2025-01-01,20\n2025-01-01,21\n", "", ["spot.csv", "line 3", "date", "must increase"]),
        ("2025-01-01,20\n", "2025-01-01,soon,3\n", ["curves.csv", "line 2", "product", "'soon'"]),
        ("2025-01-01,20\n", "2025-01-01,2025-02,x\n", ["curves.csv", "line 2", "price", "'x'"]),
        ("2025-01-01,\n", "", ["spot.csv", "it has no price"]),
    ],
)  # fmt: skip
def test_a_wrong_price_is_named(tmp_path, spot, curves, named):
    (tmp_path / "spot.csv").write_text("date,price\n" + spot)
    if curves:
        (tmp_path / "curves.csv").write_text("date,product,price\n" + curves)
    with pytest.raises(CaseError) as caught:
        read_observed(tmp_path, 0.0, [])
    for name in named:
        assert name in str(caught.value), caught.value


def test_a_pair_of_equal_histories_is_one_sample():
    """Antithetic histories count in pairs; a control of mean zero takes its part of the noise."""
    one, control = np.random.default_rng(0).standard_normal((2, 400))
    control -= control.mean()
    money, groups = np.repeat(one, 2), np.repeat(np.arange(400), 2)
    drawn = DrawnHistories(money, np.zeros((1, 800)), groups=groups)
    assert drawn.expected.standard_error == pytest.approx(one.std(ddof=1) / 20, rel=1e-12)
    noise = np.repeat(control, 2)
    noisy = drawn._replace(money=money + 5 * noise, controls=(noise,))
    assert noisy.expected.standard_error < 1.01 * drawn.expected.standard_error


def test_what_is_known_on_a_day():
    """The last curve until then; the shortest product of a day; the spot before the first one."""
    month = Quote(datetime.date(2025, 2, 1), datetime.date(2025, 2, 28), 30.0)
    week = Quote(datetime.date(2025, 2, 3), datetime.date(2025, 2, 9), 33.0)
    days = (FIRST, FIRST + 5 * ONE)
    curves = {days[0]: [month, week], days[1]: [month._replace(price=40.0)]}
    seen = ObservedMarket(Path(), days, (20.0, 25.0), days, curves)
    asked = [datetime.date(2025, 1, 20), datetime.date(2025, 2, 1), datetime.date(2025, 2, 5)]
    assert seen.curve(FIRST + 4 * ONE, asked).tolist() == [20.0, 30.0, 33.0]
    assert seen.curve(FIRST + 5 * ONE, asked).tolist() == [25.0, 40.0, 40.0]
    assert seen.spot(FIRST + 3 * ONE) == 20.0 and not seen.has_curve(FIRST - ONE)
    with pytest.raises(CaseError, match="2025-03-01"):
        seen.curve(FIRST, [datetime.date(2025, 3, 1)])
    with pytest.raises(CaseError, match=r"spot\.csv, 2025-01-07.*2025-01-01 to 2025-01-06"):
        seen.spot(FIRST + 6 * ONE)


def test_the_example_can_be_read():
    """Henry Hub: a calibration that ends before the contract, and prices of all its days."""
    folder = Path(__file__).parents[4] / "examples" / "henry_hub"
    calibration = read_calibration(folder / "calibration.toml")
    case = DOMAIN.read(*load(folder))
    assert calibration.days[-1] < case.days[0] and calibration.prices == 750
    seen = read_observed(folder, 0.0, [])
    for day in (case.days[0], case.days[200], case.days[-1]):
        assert seen.spot(day) > 0 and (seen.curve(day, case.days[-30:]) > 0).all()
    np.testing.assert_allclose(
        seen.curve(case.days[0], case.days), case.market.forward_curve.used()
    )


def test_other_kinds_and_missing_folders_are_refused(tmp_path, capsys):
    assert main(["backtest", str(CASES / "quick"), "--history", str(tmp_path / "none")]) == 2
    assert "--history" in capsys.readouterr().err
    (tmp_path / "case.toml").write_text('kind = "pension"\n')
    assert main(["backtest", str(tmp_path), "--history", str(tmp_path)]) == 2
    assert "'pension'" in capsys.readouterr().err
