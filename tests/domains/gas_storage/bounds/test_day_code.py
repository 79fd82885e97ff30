"""The best flows of a day in machine code: the bits of NumPy's."""

import numpy as np
import pytest
from tests.domains.gas_storage.references import reference_schedules as cases

from snapo.domains.gas_storage.bounds import day_code, day_grid
from snapo.domains.gas_storage.bounds.day_grid import best_value, day_grids
from snapo.domains.gas_storage.bounds.value_iteration import regular_grids
from snapo.domains.gas_storage.references.day_terms import UnitPrices

G3 = cases.dated_ratchets()


def both(day, columns: int, above: bool, draw, monkeypatch) -> list[np.ndarray]:
    """The value by machine code and by NumPy, at random prices and values."""
    pay = draw.uniform(10, 30, columns)
    prices = UnitPrices(pay=pay, earn=pay - draw.uniform(0, 3, columns))
    after = 20 * day.after[:, None] + 40 * draw.normal(size=(len(day.after), columns)).cumsum(0)
    results: list[np.ndarray] = []
    for serves in (day_code.serves, lambda columns: False):
        monkeypatch.setattr(day_grid, "serves", serves)
        results.append(best_value(day, prices, after.copy(), above))
    return results


@pytest.mark.skipif(not day_code.serves(16), reason="no machine code here")
@pytest.mark.parametrize("columns", [16, 17, 40])
@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize("inventories", [5, 60])
def test_the_bits_are_those_of_numpy(columns, above, inventories, monkeypatch):
    draw = np.random.default_rng(columns + inventories)
    days = [*day_grids(G3, "linear", inventories), *regular_grids(G3, "linear", inventories)]
    for day in days[:: 1 if inventories < 10 else 5]:
        with monkeypatch.context() as patch:
            machine, numpy = both(day, columns, above, draw, patch)
        np.testing.assert_array_equal(machine, numpy)


def test_few_columns_are_left_to_numpy():
    assert not day_code.serves(day_code.WIDTH - 1)


def test_days_with_equal_moves_share_what_follows_from_them():
    days = regular_grids(cases.flagship(), "linear", 51)
    flows = {id(day.flows): day for day in days}
    assert len(flows) < len(days) / 3
    for day in days:
        first = flows[id(day.flows)]
        for name in ("nodes", "after", "keep"):
            np.testing.assert_array_equal(getattr(day, name), getattr(first, name))
