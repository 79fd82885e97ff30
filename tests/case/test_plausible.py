"""Ranges outside which a number is noted, with its position in the files of a case."""

import numpy as np
import pytest

from snapo.case.given import CaseInput
from snapo.case.plausible import (
    CaseFiles,
    CheckedNumbers,
    Plausible,
    around,
    checked_numbers,
    implausible,
)
from snapo.problem.inputs import Input

CURVE = "# quotes\ndate,price\n2025-01,20\n2025-02,2000\n2025-03,21\n"


@pytest.fixture
def files(tmp_path):
    (tmp_path / "curve.csv").write_text(CURVE)
    (tmp_path / "assets.csv").write_text("name,weight,fee\nCash,0.5,0\nEquity,0.5,0.5\n")
    data = {
        "market": {"forward_curve": "curve.csv", "interest_rate": 0.9},
        "assets": {"file": "assets.csv"},
        "rates": {"volatility": [0.9, 0.5]},
        "units": {"reactor": {"temperature": "25 K"}},
        "missing": {"file": "none.csv"},
        "on": True,
    }
    return CaseFiles(tmp_path / "case.toml", data)


@pytest.mark.parametrize(
    ("name", "label", "value", "position"),
    [
        ("forward_curve", "2025-02-03", 2000.0, "curve.csv, line 4, column price"),
        ("interest_rate", "", 0.9, "market.interest_rate"),
        ("rate_volatility", "rate", 0.9, "rates.volatility[0]"),
        ("rate_volatility", "rate 2", 0.5, "rates.volatility[1]"),
        ("asset_fee", "Equity", 0.5, "assets.csv, line 3, column fee"),
        ("asset_weight", "Equity", 0.5, "assets.csv, line 3, column weight"),
        ("asset_weight", "Cash", 0.5, "assets.csv, line 2, column weight"),
        ("interest_rate", "", np.log1p(0.9), "market.interest_rate"),  # annual in the file
        ("reactor.temperature", "", 25.0, "units.reactor.temperature"),
        ("reactor.density", "", 123.0, "reactor.density"),  # in no file
    ],
)
def test_a_number_is_located(files, name, label, value, position):
    assert files.position(name, label, value) == position


def test_a_note_has_position_number_unit_range_and_hint(files):
    rate = CaseInput(
        "interest_rate", np.array([0.9]), ("",), "1/year", np.array(0), display_unit="bp",
        display_factor=1e4, group="interest rate",
    )  # fmt: skip
    range_ = Plausible(-0.02, 0.25, "0.02 is 2 %", group="interest rate")
    (note,) = implausible([rate], [range_], files).values()
    assert note == (
        "market.interest_rate: interest_rate is 9,000 bp (0.9), outside -200 to 2,500 bp: 0.02 is 2 %."
    )
    (again,) = implausible(
        [checked_numbers(rate.input(), "interest_rate")], [range_], files
    ).values()
    assert again == note


def test_an_input_with_several_such_numbers_has_one_note(files):
    range_ = Plausible(0.0, 0.1, "it is a share", endings=("fee",), unit="1")
    fees = CheckedNumbers("fee", np.array([0.0, 0.5, 0.7, 0.05]), ("a", "b", "c", "d"), "1")
    (note,) = implausible([fees], [range_], files).values()
    assert "fee b is 0.5, outside 0 to 0.1, as is 1 more of its numbers: it is a share." in note
    other = fees._replace(unit="1/year")
    assert not implausible([other], [range_], files)


def test_what_is_made_from_a_noted_input_is_not_noted_again(files):
    range_ = Plausible(0.0, 0.1, "a hint")
    zero = CheckedNumbers("zero", np.array([0.5]), ("",))
    forward = CheckedNumbers("forward", np.array([0.6]), ("",), source="zero")
    assert len(implausible([zero, forward], [range_], files)) == 1
    assert len(implausible([zero._replace(values=np.array([0.1])), forward], [range_], files)) == 1


@pytest.mark.parametrize(
    ("value", "noted"), [(0.0, False), (1e-4, True), (-1e-4, True), (1e-3, False), (-2.0, True)]
)
def test_a_zero_has_no_unit_and_a_size_has_no_sign(files, value, noted):
    range_ = Plausible(1e-3, 1.0, "a hint", by_size=True)
    entry = CheckedNumbers("x", np.array([value]), ("",))
    assert bool(implausible([entry], [range_], files)) == noted


def test_a_number_a_hundred_times_its_neighbours_is_noted(files):
    labels = tuple(f"2025-{m:02d}-{d:02d}" for m in (1, 2, 3) for d in range(1, 29))
    curve = CheckedNumbers("forward_curve", np.repeat([20.0, 2000.0, 21.0], 28), labels, "EUR/MWh")
    (note,) = implausible([curve], [Plausible(-np.inf, np.inf, "", ratio=20.0)], files).values()
    assert note == (
        "curve.csv, line 4, column price: forward_curve 2025-02-01 is 2,000 EUR/MWh, "
        "97.6 times its neighbours, which are about 20.5 EUR/MWh: is it in the same unit?"
    )
    calm = curve._replace(values=np.linspace(1.0, 60.0, 84))
    assert not implausible([calm], [Plausible(-np.inf, np.inf, "", ratio=20.0)], files)


@pytest.mark.parametrize(
    ("values", "usual"),
    [
        ([], []),
        ([3.0], [np.nan]),
        ([3.0, 3.0], [np.nan, np.nan]),
        ([1.0, 2.0], [2.0, 1.0]),
        # Of four neighbours with one wrong number the median is between right ones.
        ([1.0, 1.1, 110.0, 1.2, 1.3], [1.25, 1.25, 1.15, 1.2, 1.15]),
        ([1.0, 1.0, 9.0, 1.2], [5.1, 5.1, 1.1, 5.0]),
    ],
)
def test_neighbours_along_a_curve(values, usual):
    assert around(np.array(values)) == pytest.approx(np.array(usual), nan_ok=True)


def test_the_accessor_reads_inputs_of_a_simulator():
    result = checked_numbers(
        Input([[1.0, 2.0]], "EUR", display_unit="cent", display_factor=100.0), "cost"
    )
    assert (result.name, result.values.tolist(), result.labels) == ("cost", [1.0, 2.0], ("0", "1"))
    assert (result.display_unit, result.display_factor) == ("cent", 100.0)
    assert checked_numbers(Input(3.0), "x").labels == ("",)
