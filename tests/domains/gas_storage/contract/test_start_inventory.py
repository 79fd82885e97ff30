"""The gas in store at the start may miss its limits by rounding, as on every later date."""

import jax
import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import read

from snapo.case.error import CaseError
from snapo.domains.gas_storage.references.intrinsic import intrinsic
from snapo.domains.gas_storage.setup import bare_problem

THIRDS = 200 / 3


def store(**contract):
    return read("quick", contract=contract)


def plan(case) -> float:
    return intrinsic(jax.tree.map(np.asarray, bare_problem(case).schedule), "linear").value


@pytest.mark.parametrize(
    ("limits", "exact", "rounded"),
    [
        # As the planned inventory of an explanation, with 9 decimals.
        ({"max_inventory": THIRDS, "max_withdrawal": 10.0}, THIRDS, round(THIRDS, 9)),
        # As the gas in store in a back-test.
        ({"min_inventory": 10.3, "end_inventory": 10.3}, 10.3, 10.299999999999997),
    ],
    ids=["full", "empty"],
)
def test_rounding_is_allowed(limits, exact, rounded):
    assert exact != rounded
    value = plan(store(**limits, inventory=exact))
    assert plan(store(**limits, inventory=rounded)) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("inventory", [THIRDS + 1e-6, 10.3 - 1e-6])
def test_more_is_not(inventory):
    with pytest.raises(CaseError, match=r"inventory.*the limits allow 10\.3 to 66\.66666667"):
        store(min_inventory=10.3, max_inventory=THIRDS, end_inventory=10.3, inventory=inventory)
