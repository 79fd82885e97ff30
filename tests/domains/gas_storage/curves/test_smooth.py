"""Smooth curves through the means of periods: D8 of the reference cases, exact to its digits."""

import datetime
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from snapo.domains.gas_storage.curves.products import delivery
from snapo.domains.gas_storage.curves.smooth import Undetermined, prices_of_means

QUOTES = {
    "2025-12": 31.50, "2026-01": 32.20, "2026-02": 32.00, "2026-03": 30.10, "2026-Q2": 26.40,
    "2026-Q3": 25.90, "winter 2026": 29.30,
}  # fmt: skip
START = datetime.date(2025, 12, 1)
# Day: daily, daily with weekends at 0.94, spline with a flat end, spline with a free end.
# shared/cases/desk.md, D8: computed there by dense linear algebra in higher precision.
REFERENCE = {
    "2025-12-01": (31.102471, 31.543004, 31.103040, 31.102517),
    "2025-12-15": (31.476089, 31.969417, 31.476090, 31.476089),
    "2026-01-31": (32.364333, 30.961344, 32.364977, 32.364346),
    "2026-02-14": (32.101353, 30.699693, 32.101606, 32.101344),
    "2026-03-31": (28.887086, 29.405495, 28.891457, 28.886990),
    "2026-05-15": (26.110085, 26.564179, 26.120801, 26.110084),
    "2026-08-15": (25.810872, 24.680674, 25.782877, 25.810862),
    "2026-12-31": (29.302078, 29.814099, 29.560741, 29.302068),
    "2027-03-31": (31.722904, 32.268145, 30.592283, 31.723033),
}


def periods() -> list[tuple[int, int]]:
    days = [delivery(name) for name in QUOTES]
    return [((first - START).days, (last - START).days + 1) for first, last in days]


def day(text: str) -> int:
    return (datetime.date.fromisoformat(text) - START).days


def weekends(count: int) -> np.ndarray:
    weekday = [(START + datetime.timedelta(i)).weekday() for i in range(count)]
    return np.where(np.array(weekday) >= 5, 0.94, 1.0)


@pytest.mark.parametrize("column", range(4))
def test_the_curves_are_those_of_the_reference(column):
    count = periods()[-1][1]
    factors = weekends(count) if column == 1 else np.ones(count)
    smoother = "spline" if column >= 2 else "daily"
    matrix = prices_of_means(periods(), factors, smoother, column == 2)
    prices = matrix @ np.array(list(QUOTES.values()))
    for text, values in REFERENCE.items():
        assert prices[day(text)] == pytest.approx(values[column], abs=1.1e-6), text


def test_derivatives_with_respect_to_quotes_are_those_of_the_reference():
    count = periods()[-1][1]
    matrix = prices_of_means(periods(), np.ones(count))
    february = [0.010098, -0.069851, 1.137746, -0.085984, 0.009845, -0.002096, 0.000243]
    winter = [-0.006004, 0.029826, -0.081676, 0.120605, -0.137463, 0.101709, 0.973004]
    np.testing.assert_allclose(matrix[day("2026-02-14")], february, atol=1e-6)
    np.testing.assert_allclose(matrix[day("2026-12-31")], winter, atol=1e-6)
    prices = matrix @ np.array(list(QUOTES.values()))
    assert np.sum(np.diff(prices, 2) ** 2) == pytest.approx(2.870718e-4, rel=1e-6)


@given(
    st.lists(st.integers(1, 90), min_size=1, max_size=8),
    st.sampled_from(["daily", "spline"]),
    st.booleans(),
    st.integers(0, 99),
)
def test_the_curve_has_the_means_of_its_periods(lengths, smoother, flat_end, seed):
    """Of any periods one after another, with any factors; a common price gives itself times them."""
    limits = np.cumsum([0, *lengths])
    parts = list(pairwise(limits))
    factors = np.random.default_rng(seed).uniform(0.8, 1.2, limits[-1])
    matrix = prices_of_means(parts, factors, smoother, flat_end)
    means = np.array([matrix[first:after].mean(0) for first, after in parts])
    np.testing.assert_allclose(means, np.eye(len(parts)), atol=1e-7)
    plain = prices_of_means(parts, np.ones(limits[-1]), smoother, flat_end)
    np.testing.assert_allclose(plain.sum(1), 1, atol=1e-7)


def test_two_periods_about_one_day_leave_the_slope_open():
    with pytest.raises(Undetermined):
        prices_of_means([(0, 31), (10, 21)], np.ones(31))
