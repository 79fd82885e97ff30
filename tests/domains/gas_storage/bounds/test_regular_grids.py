"""Grids that follow from the contract alone, and the value fitted on them."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.domains.gas_storage.references import reference_schedules as cases

from snapo.domains.gas_storage.bounds.value_iteration import (
    fit_value,
    fit_value_table,
    regular_grids,
)

G3 = cases.dated_ratchets()  # sixteen days, ratchets that change
EXACT = 24_808.2  # with volumes between the extremes


def moved(**steps):
    """G3 with other numbers of its days."""
    return G3._replace(steps=SimpleNamespace(**{**vars(G3.steps), **steps}))


def test_a_moved_curve_keeps_the_grids():
    days = regular_grids(G3, "linear", 21)
    assert regular_grids(moved(forward=1.1 * G3.steps.forward), "linear", 21) is days


@pytest.mark.parametrize(
    "name", ["injection_rate", "next_high", "inventory_loss", "inventory_cost"]
)
def test_another_contract_has_other_grids(name):
    days = regular_grids(G3, "linear", 21)
    number = getattr(G3.steps, name)
    other = moved(**{name: 0.99 * number + 1e-3})
    found = regular_grids(other, "linear", 21)
    assert found is not days
    regular_grids(G3, "linear", 21)
    again = regular_grids(other, "linear", 21)
    for one, two in zip(found, again):
        np.testing.assert_array_equal(one.keep, two.keep)
        np.testing.assert_array_equal(one.cost, two.cost)


def test_the_value_of_the_table_is_near_the_finer_one_and_the_exact_one():
    fine = fit_value(G3, G3.factors, "linear").value
    table = fit_value_table(G3, G3.factors, "linear").value
    assert abs(table - fine) < 2e-3 * EXACT
    assert abs(table - EXACT) < 5e-3 * EXACT


def test_louder_prices_are_not_those_of_the_last_fit():
    """Loadings are no part of the functions, whose regression is kept, but of the spot price."""
    quiet = fit_value_table(G3, G3.factors, "linear").value
    of = G3.factors
    louder = of._replace(loading=2 * of.loading, variance=4 * of.variance)
    assert fit_value_table(G3, louder, "linear").value != quiet
    assert fit_value_table(G3, of, "linear").value == quiet
