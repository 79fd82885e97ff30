"""Figures from recorded paths."""

import numpy as np
from tests.domains.pension.market_cases import full

from snapo.domains.pension.chapters.paths import SLACK, RecordedPaths, limits_by_step


def test_round_off_is_no_breach_of_a_limit():
    """A policy that holds exactly as many swaps as are backed breaks the limit in the last bit."""
    shape = (3, 4)
    short, excess = np.full(shape, 1.3e-16), np.full(shape, 2e-16)
    short[1, 2], excess[2, :2] = 1e-6, 1e-6
    outputs = {"bound_excess": excess, "collateral_shortfall": short}
    record = RecordedPaths(full(3), np.zeros((3, 4, 9)), outputs, np.ones((4, 4)))
    found = limits_by_step(record, SLACK)
    assert found["collateral"].ever == 0.25
    assert found["collateral"].share.tolist() == [0, 0.25, 0]
    assert found["weights"].ever == 0.5
