"""A number with its standard error is printed to the two significant digits of the error."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snapo.solver.bound import Between
from snapo.solver.evaluate import Value
from snapo.solver.statistics import Estimate, Sampled, with_error

INF, NAN = math.inf, math.nan


@pytest.mark.parametrize(
    "value, error, said",
    [
        (2731.93, 20.87, "2,732 ± 21"),
        (-2731.93, 20.87, "-2,732 ± 21"),
        (78312.4, 341.0, "78,310 ± 340"),
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (0.5, 0.0996, "0.50 ± 0.10"),
        (12.3, 9.96, "12 ± 10"),
        (0.0, 0.04, "0.000 ± 0.040"),
        (0.001, 21.0, "0 ± 21"),
        (-0.001, 21.0, "0 ± 21"),
        (2731.93, 0.0, "2,731.93 ± 0"),
        (1 / 3, 0.0, "0.333333333333 ± 0"),
        (0.0, 0.0, "0 ± 0"),
        (2731.93, NAN, "2,731.93 ± nan"),
        (NAN, NAN, "nan ± nan"),
        (-INF, NAN, "-inf ± nan"),
        (-INF, 0.5, "-inf ± 0.5"),
        (3.0, INF, "3 ± inf"),
        (1.2345e-7, 2.1e-9, "(1.235 ± 0.021)e-07"),
        (1.2345e15, 2.1e12, "(1.2345 ± 0.0021)e+15"),
        (3.0, 4e15, "(0.0 ± 4.0)e+15"),
        (2731.93, 3.1e-14, "2,731.93 ± 3.1e-14"),
        (np.float32(0.5), np.float64(0.01), "0.500 ± 0.010"),
    ],
)
def test_as_many_digits_as_the_error_supports(value, error, said):
    assert with_error(value, error) == said


SIZES = st.floats(-1e100, 1e100, allow_subnormal=False)
ERRORS = st.floats(1e-100, 1e100, allow_subnormal=False)


@settings(max_examples=500)
@given(SIZES, ERRORS)
def test_what_is_printed_is_the_number_to_a_twentieth_of_the_error(value, error):
    said = with_error(value, error)
    if scaled := re.fullmatch(r"\((.*) ± (.*)\)e([+-]\d+)", said):
        first, second = (float(x.replace(",", "")) for x in scaled.groups()[:2])
        power = float(f"1e{scaled[3]}")
    else:
        first, second = (float(x.replace(",", "")) for x in said.split(" ± "))
        power = 1.0
    assert len(said) < 48
    np.testing.assert_allclose(second * power, error, rtol=0.051)
    if error > 1.1e-12 * abs(value):
        assert abs(first * power - value) <= 0.051 * error + 1e-15 * abs(value)
        digits = re.sub(r"[^\d]", "", said.split(" ± ")[1].split(")")[0].split("e")[0]).lstrip("0")
        assert len(digits.rstrip("0")) <= 2
    else:
        np.testing.assert_allclose(first * power, value, rtol=1e-11)


def test_estimates_are_printed_with_their_errors():
    assert str(Value(2731.93, 20.87)) == str(Sampled(2731.93, 20.87)) == "2,732 ± 41"
    assert str(Between(2731.93, 20.87, 2691.0, 2772.8)) == "2,732 ± 41"
    assert f"{Value(2731.93, 20.87)}" == "2,732 ± 41"
    blocks = np.array([1.0, 2.0, 3.0, 4.0])
    assert str(Estimate(blocks)) == "2.5 ± 2.1"  # of four blocks: 3.18 standard errors
    assert str(Estimate(np.stack([blocks, 10 * blocks], 1))) == "[2.5 ± 2.1, 25 ± 21]"
    many = str(Estimate(blocks[:, None, None] * np.ones((4, 5, 2))))
    assert many == "[2.5 ± 2.1, 2.5 ± 2.1, 2.5 ± 2.1, … (10 numbers)]"
    assert str(Estimate(np.array([2.5]))) == "2.5 ± nan"
