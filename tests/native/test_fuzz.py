"""A few of the random step functions; `fuzz.py` runs thousands."""

import fuzz
import pytest


@pytest.mark.parametrize("case", range(2))
def test_random_step_functions(case):
    assert fuzz.compare(1000 * case) <= 1


@pytest.mark.slow
def test_two_thousand_random_step_functions():
    assert fuzz.main(2000) == 0
