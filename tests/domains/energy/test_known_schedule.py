"""`snapo check` evaluates a contract in NumPy: its schedule is that of the simulator."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.energy.energy_cases import HOME, battery, case_at, plant, swing
from tests.domains.energy.test_bank import CARRY, CHEAP, MAKE_UP, TWO, three_years, two_years
from tests.domains.energy.test_certificates import of_template, with_market
from tests.domains.energy.test_index import indexed
from tests.domains.energy.test_swing import firm_with_rights
from tests.lanes.in_numpy import in_numpy

from snapo.domains.energy.core.intraday import simulator_kind
from snapo.domains.energy.methods.intrinsic import intrinsic_value
from snapo.domains.energy.summary import known_schedule
from snapo.problem.inputs import plain

PARK = HOME / "template_park_and_loan"
LEFT = {"contract.cash_out_park": 20.0, "contract.cash_out_loan": 60.0}
INTRADAY = {"auction": {"at": "12:00"}, "intraday": {"half_spread": 2.0}}
CASES: dict[str, Any] = {
    "battery": lambda folder: battery(),
    "battery with cycles": lambda folder: battery(cycles={"day": 1.5, "term": 8.0}),
    "swing": lambda folder: swing(),
    "rights": lambda folder: firm_with_rights(10, 20, 12, 1),
    "indexed": lambda folder: indexed(),
    "two years": lambda folder: two_years(folder, CHEAP, **MAKE_UP, **CARRY),
    "three years": lambda folder: three_years(folder, (22.0, 34.0, 27.0), **TWO),
    "firm": lambda folder: two_years(folder, CHEAP, shortfall=None, **CARRY),
    "park and loan": lambda folder: case_at(PARK, {}),
    "cash-out": lambda folder: case_at(PARK, LEFT),
    "plant": lambda folder: plant(),
    "certificates": lambda folder: with_market(of_template(folder), 0.5),
    "stores": lambda folder: case_at(HOME / "template_stores", {}),
}


def assert_same(found, expected, where: str) -> None:
    """All arrays of two trees of tuples, to rounding."""
    assert (found is None) == (expected is None), where
    if isinstance(expected, tuple):
        for name, x, y in zip(expected._fields, found, expected, strict=True):
            assert_same(x, y, f"{where}.{name}")
    elif expected is not None:
        expected = np.asarray(expected)
        largest = np.max(np.abs(expected), initial=1.0, where=np.isfinite(expected))
        assert_allclose(found, expected, rtol=1e-11, atol=1e-12 * largest, err_msg=where)


@pytest.mark.prove
@pytest.mark.parametrize("name", CASES)
def test_the_schedule_of_a_check_is_that_of_the_simulator(name, tmp_path):
    case = CASES[name](tmp_path / "case")
    found = known_schedule(case)
    schedule = in_numpy(simulator_kind(case).bare(case).prepare)(plain(case.inputs()))
    for part in ("time", "forward", "terms", "intervals"):
        assert_same(getattr(found.steps, part), getattr(schedule.steps, part), part)
    assert_allclose(found.constants.start, schedule.constants.start, rtol=1e-12)
    if case.contract.layout.indexed:
        index = schedule.steps.price.index.expected()
        assert_allclose(found.steps.price.index.expected()[: len(index)], index, rtol=1e-12)
    value = intrinsic_value(case.contract.layout, schedule)
    assert intrinsic_value(case.contract.layout, found) == pytest.approx(value, rel=1e-9, abs=1e-6)
