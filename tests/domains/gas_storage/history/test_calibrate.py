"""`snapo calibrate`: files, mistakes in them, the table for a case, and the interval of a value."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm
from tests.domains.gas_storage.storage_cases import CASES

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.cli.main import main
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.history.calibrate import derivatives_of, model_table, value_interval
from snapo.domains.gas_storage.history.kalman import Filtered
from snapo.domains.gas_storage.history.maximum import HistoryEstimate, HistoryFit, unknown
from snapo.domains.gas_storage.history.model import HistoryModel
from snapo.domains.gas_storage.history.read import read_calibration

from .drawn import drawn, empty_history

SPOT = '[history]\nspot = "spot.csv"\n'
ONE = '[model]\nkind = "one-factor"\n'


def written(folder: Path, history: str = SPOT, model: str = ONE, **files: str) -> Path:
    """A calibration in a folder, with CSVs by name."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    (folder / "case.toml").write_text(f'kind = "calibration"\n{history}{model}')
    return folder


def days(count: int, price: str = "20.5", **others: str) -> str:
    """A CSV of daily prices from 1 January 2024; `others`: d3 = "-1" is the price of line 5."""
    dates = np.arange(count) + np.datetime64("2024-01-01")
    return "date,price\n" + "".join(
        f"{date},{others.get(f'd{i}', price)}\n" for i, date in enumerate(dates)
    )


@pytest.mark.parametrize(
    ("history", "model", "spot", "named"),
    [
        (SPOT, ONE, days(30, d3="-1.5"), ["spot.csv", "line 5", "price", "-1.5", "normal"]),
        (SPOT, ONE, days(30, d3="abc"), ["spot.csv", "line 5", "'abc'", "a finite number"]),
        (SPOT, ONE, days(30).replace("2024-01-03", "2024-01-01"), ["line 4", "must increase"]),
        (SPOT, ONE, days(12), ["history.spot", "12 prices", "at least 20 dates"]),
        ("[history]\n", ONE, days(30), ["history.spot", "spot, quotes or maturities"]),
        (SPOT + 'exact = ["sport"]\n', ONE, days(30), ["history.exact", "'sport'", "spot"]),
        (SPOT + "first = 2025-01-01\n", ONE, days(30), ["history.first", "no price from 2025"]),
        (SPOT + "first = 2024-02-01\nlast = 2024-01-01\n", ONE, days(30), ["history.last"]),
        (SPOT + "first = 2024-01-15\n", ONE, days(30), ["16 prices on 16 dates"]),
        (SPOT + "season = 5\n", ONE, days(30), ["history.season", "5", "0, 1 or 2"]),
        (SPOT + "step = 0.0\n", ONE, days(30), ["history.step", "above 0"]),
        (SPOT, '[model]\nkind = "regimes"\n', days(30), ["model.kind", "'regimes'", "one-factor"]),
        (SPOT, ONE + "shift = 3.0\n", days(30), ["model.shift", "3", "one-factor-shifted"]),
        (SPOT.replace("spot.csv", "no.csv"), ONE, days(30), ["history.spot", "no.csv"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_message(tmp_path, history, model, spot, named, capsys):
    folder = written(tmp_path, history, model, spot=spot)
    assert main(["calibrate", str(folder)]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and not (tmp_path / "calibration").exists()
    for name in named:
        assert name in printed.err, printed.err


@pytest.mark.parametrize(
    ("row", "named"),
    [
        ("2024-01-01,2024-13,20\n", ["line 3", "product", "2024-13"]),
        ("2024-01-01,2023-12,20\n", ["line 3", "product", "its delivery begins on 2023-12-01"]),
        ("2024-01-01,2025,20\n", ["line 3", "product", "at most 92 days"]),
        ("2024-01-01,2024-02,21\n", ["line 3", "product", "already"]),
        ("2024-01-01,someday,20\n", ["line 3", "product", "a month (2026-01)"]),
    ],
)
def test_quotes_are_of_products_not_begun(tmp_path, row, named):
    text = "date,product,price\n2024-01-01,2024-02,20\n" + row
    folder = written(tmp_path, '[history]\nquotes = "quotes.csv"\n', quotes=text)
    with pytest.raises(CaseError) as caught:
        read_calibration(folder)
    for name in named:
        assert name in str(caught.value), caught.value


def test_prices_may_be_in_a_folder_below_the_calibration(tmp_path):
    """Unlike the files of a case, they are never copied."""
    folder = written(tmp_path, SPOT.replace("spot.csv", "data/spot.csv"), spot=days(30))
    (folder / "data").mkdir()
    (folder / "spot.csv").rename(folder / "data" / "spot.csv")
    assert read_calibration(folder).prices == 30


def test_prices_of_all_files_meet_on_their_dates(tmp_path):
    """Spot, constant maturities with an empty cell, and quotes whose maturity changes."""
    table = "date,F1,month 12\n" + "".join(f"2024-01-{d:02},30,{d}\n" for d in range(1, 25))
    quotes = "date,product,price\n2024-01-03,2024-03,31\n2024-01-02,2024-Q2,32\n"
    keys = 'maturities = "table.csv"\nquotes = "quotes.csv"\nstep = 0.02\n'
    table = table.replace("2024-01-05,30,", "2024-01-05,,")
    folder = written(tmp_path, SPOT + keys, spot=days(24), table=table, quotes=quotes)
    result = read_calibration(folder)
    history = result.history
    assert result.model.columns == ("spot", "f1", "month 12", "quotes")
    assert result.model.exact == ("spot",) and result.model.quoted
    assert result.prices == 24 + 2 * 24 - 1 + 2 and history.present.sum() == result.prices
    assert history.present.sum(axis=1)[:6].tolist() == [3, 4, 4, 3, 2, 3]
    np.testing.assert_allclose(history.gap, [0.0, *[0.02] * 23])
    # The second quarter from 1 April to 30 June: its middle is 16 May, day 135 after 2 January.
    assert history.years[1, 3] == pytest.approx(135 / 365)
    assert history.years[2, 3] == pytest.approx(73 / 365)  # 16 March, from 3 January
    assert history.years[0, :3].tolist() == [0.0, 1 / 12, 1.0]
    assert float(history.value[4, 1]) == pytest.approx(np.log(5.0))
    assert history.phase[1, 0] == pytest.approx(1 / 366)


def test_no_more_prices_are_exact_than_there_are_factors(tmp_path):
    table = "date,F1,F2\n" + "".join(f"2024-01-{d:02},30,31\n" for d in range(1, 25))
    keys = '[history]\nmaturities = "table.csv"\nexact = ["F1", "F2"]\n'
    with pytest.raises(CaseError, match=r"line 2, column f2.*history\.exact"):
        read_calibration(written(tmp_path, keys, table=table))
    two = read_calibration(written(tmp_path, keys, '[model]\nkind = "multi-factor"\n', table=table))
    assert two.model.exact == ("f1", "f2")


def made(kind: str = "multi-factor", factors: int = 2) -> HistoryFit:
    """Estimates as of a fit."""
    shift = 4.0 if kind == "one-factor-shifted" else 0.0
    model = HistoryModel(kind, factors, shift=shift, normal=kind == "one-factor-normal")
    count = len(model.names)
    numbers = np.array([12.0, 0.6, 0.01, 0.2, 0.3] if factors == 2 else [12.0, 0.6, 3.0])
    errors = np.array([2.0, 0.05, 0.1, 0.02, 0.1] if factors == 2 else [2.0, 0.05, 0.1])
    covariance = np.diag(errors**2)
    covariance[0, 1] = covariance[1, 0] = 0.06
    estimate = HistoryEstimate(
        model.names, numbers, errors, numbers - 2 * errors, numbers + 2 * errors,
        covariance, np.zeros(count, bool), 100.0, True,
    )  # fmt: skip
    return HistoryFit(model, estimate, Filtered(*map(np.zeros, (1, 1, 1))), ())  # pyright: ignore


@pytest.mark.parametrize(
    ("kind", "factors"),
    [("multi-factor", 2), ("one-factor", 1), ("one-factor-normal", 1), ("one-factor-shifted", 1)],
)
def test_the_table_is_that_of_a_case(kind, factors):
    result = made(kind, factors)
    file, data = load(CASES / "G4")
    case = DOMAIN.read(file, data | {"model": model_table(result)})
    assert case.model.kind == kind
    values = {x.name: x.values.tolist() for x in (case.model.mean_reversion, case.model.volatility)}
    expected = ([12.0, 0.0], [0.6, 0.2]) if factors == 2 else ([12.0], [0.6])
    assert (values["mean_reversion"], values["volatility"]) == expected


def test_the_interval_of_a_value_has_the_covariance_of_the_parameters():
    """sqrt(d' C d) by hand, with d = (-3, 50) for mean reversion and volatility."""
    result = value_interval(made(), {"mean_reversion": -3.0, "volatility": 50.0})
    exact = np.sqrt(9 * 4 + 2500 * 0.0025 - 2 * 150 * 0.06)
    assert result["standard_error"] == pytest.approx(exact, rel=1e-12)
    assert result["shares"] == {
        "mean_reversion": pytest.approx(6),
        "volatility": pytest.approx(2.5),
    }


def test_wide_intervals_are_unknown():
    model = HistoryModel("multi-factor", 2)  # speed, volatility, drift, volatility, correlation
    narrow = np.array([10.0, 0.5, -0.004, 0.1, -0.2]), np.array([14.0, 0.7, 0.006, 0.2, 0.2])
    wide = np.array([1.0, 0.01, -0.1, 0.01, -0.6]), np.array([14.0, 0.7, 0.02, 0.2, 0.5])
    assert not unknown(model, *narrow).any()
    assert unknown(model, *wide).all()


@pytest.mark.prove
def test_the_derivatives_of_a_run_are_found(solved, tmp_path):
    run = solved("gas-storage") / "run"
    table = derivatives_of(run, "one-factor")
    assert set(table) == {"mean_reversion", "volatility"} and table["volatility"] > 0
    with pytest.raises(CaseError, match=r"model\.kind: got 'one-factor'.*\"multi-factor\""):
        derivatives_of(run, "multi-factor")
    with pytest.raises(CaseError, match="run"):
        derivatives_of(tmp_path, "one-factor")


EXACT = {"xatol": 1e-9, "fatol": 1e-10, "maxiter": 2000}


def _negative(variables: np.ndarray, x: np.ndarray) -> float:
    """Minus the log-density: x(0) is stationary, x(t + 1) normal around its conditional mean."""
    a, s, m = np.exp(variables)
    decay, stationary = np.exp(-a / 365), s / np.sqrt(2 * a)
    step = norm.logpdf(x[1:], m + decay * (x[:-1] - m), stationary * np.sqrt(1 - decay**2))
    return -float(norm.logpdf(x[0], m, stationary) + step.sum())


@pytest.mark.prove
def test_a_history_from_its_file_to_a_table(tmp_path, capsys):
    """The estimates maximise the stationary density of an autoregression, written as one."""
    model = HistoryModel("one-factor-normal", 1, normal=True)
    truth = {"mean_reversion": 40.0, "volatility": 70.0, "level": 14.0}
    x = np.asarray(drawn(model, truth, empty_history(700, [0.0], 1 / 365), 3).value[:, 0])
    dates = np.arange(700) + np.datetime64("2023-01-01")
    spot = "date,price\n" + "".join(f"{d},{p!r}\n" for d, p in zip(dates, x.tolist()))
    kind = ONE.replace("one-factor", "one-factor-normal")
    assert main(["calibrate", str(written(tmp_path, SPOT, kind, spot=spot)), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    rows = {row["parameter"]: row for row in answer["parameters"]}
    start = np.log([30.0, 50.0, 10.0])
    best = minimize(_negative, start, args=(x,), method="Nelder-Mead", options=EXACT)
    for row, number in zip(answer["parameters"], np.exp(best.x)):
        assert row["estimate"] == pytest.approx(number, rel=1e-5)
    assert answer["log_likelihood"] == pytest.approx(-best.fun, abs=1e-6)
    for name, value in truth.items():
        assert rows[name]["low"] < value < rows[name]["high"] and not rows[name]["unknown"]
    table = tomllib.loads((tmp_path / "calibration" / "model.toml").read_text())["model"]
    assert table == answer["model"] and table["kind"] == "one-factor-normal"
    states = np.genfromtxt(tmp_path / "calibration" / "states.csv", delimiter=",", names=True)
    # An exact spot price is the factor: price less level, without an error.
    np.testing.assert_allclose(states["short_term"] + rows["level"]["estimate"], x, atol=1e-9)
    np.testing.assert_allclose(states["short_term_error"], 0.0, atol=1e-6)
