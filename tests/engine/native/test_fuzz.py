"""A few of the random step functions, of one size, as XLA's kernels then serve all; `fuzz.py` runs
thousands."""

import pytest
from tests.engine.native import fuzz


@pytest.mark.prove
def test_random_step_functions():
    for case in range(2, 38, 6):
        agree, word = fuzz.compare(case)
        assert agree, f"case {case}: {word}"


@pytest.mark.study
def test_two_thousand_random_step_functions():
    assert fuzz.main(2000) == 0
