"""Values kept by breakpoints: flows off a regular grid neither raise a bound nor lower a value."""

import numpy as np
import pytest
from tests.domains.gas_storage.bounds.test_basis import paths
from tests.domains.gas_storage.bounds.test_hindsight import exactly, spots_of, wild
from tests.domains.gas_storage.references import reference_schedules as cases

from snapo.domains.gas_storage.bounds.relaxation import Hindsight
from snapo.domains.gas_storage.bounds.value_iteration import fit_value
from snapo.domains.gas_storage.references.breakpoints import breakpoints
from snapo.domains.gas_storage.references.lattice import lattice, refined
from snapo.domains.gas_storage.references.piecewise import visited

# 40 days of forced flows of 0.3, up to 1, of 30.7 units; 3.05 to 9 must be left.
OFF = cases.swing_as_store(0.3, end="2026-11-10", left=(3.05, 9.0), held=30.7)


def bound(schedule, fitted, count: int) -> tuple[float, float]:
    """The mean over so many paths, half of them antithetic, and its standard error."""
    states = paths(schedule.factors, count)
    best = Hindsight(schedule, "linear", fitted).best(spots_of(schedule, states), states)
    pairs = (best[: count // 2] + best[count // 2 :]) / 2
    return pairs.mean(), pairs.std(ddof=1) / np.sqrt(count // 2)


def test_every_path_has_its_exact_value_whatever_the_penalty():
    states = paths(OFF.factors, 8, seed=3)
    spots = spots_of(OFF, states)
    inner = Hindsight(OFF, "linear", wild(OFF, 11, seed=1))
    np.testing.assert_allclose(
        inner.best(spots, states), exactly(inner, spots, states), rtol=1e-10, atol=1e-6
    )


def test_flows_off_a_regular_grid_leave_the_bound_narrow():
    exact = refined(OFF, OFF.factors, "linear").value
    fitted = fit_value(OFF, OFF.factors, "linear")
    value, error = bound(OFF, fitted, 256)
    assert exact - 3 * error <= value <= 1.005 * exact + 3 * error
    assert fitted.value == pytest.approx(exact, rel=1e-3)


def test_the_lattice_on_breakpoints_is_the_limit_of_fine_regular_grids():
    nodes = breakpoints(OFF, "linear", *visited(OFF, "linear"))
    value = lattice(OFF, OFF.factors, "linear", nodes=nodes).value
    # All flows and limits are multiples of 0.05: that regular grid is exact, and slow.
    assert value == pytest.approx(lattice(OFF, OFF.factors, "linear", step=0.05).value, rel=1e-9)
    assert lattice(OFF, OFF.factors, "linear", step=0.7).value < value * (1 - 1e-4)


def test_there_are_no_breakpoints_to_keep_of_ratchets_losses_and_too_many_flows():
    ratchets = cases.dated_ratchets()
    assert breakpoints(ratchets, "linear", *visited(ratchets, "linear")) is None
    limits = visited(OFF, "linear")
    assert breakpoints(OFF, "linear", *limits, maximum=10) is None
    OFF.steps.inventory_loss = OFF.steps.inventory_loss + 1e-3
    try:
        assert breakpoints(OFF, "linear", *limits) is None
    finally:
        OFF.steps.inventory_loss = 0 * OFF.steps.inventory_loss


# Exact values were computed by an independent lattice.
@pytest.mark.prove
@pytest.mark.parametrize(
    ("schedule", "exact"),
    [
        (cases.large_store(), 283_717),
        (cases.swing_as_store(0.3), 618.135),
    ],
    ids=["far larger than its flows", "forced flows"],
)
def test_a_year_between_a_narrow_bound_and_the_reference(schedule, exact):
    value, error = bound(schedule, fit_value(schedule, schedule.factors, "linear"), 512)
    assert exact - 3 * error <= value <= 1.005 * exact
    reference = refined(schedule, schedule.factors, "linear")
    assert reference.error <= 2e-4 * exact
    assert reference.value == pytest.approx(exact, rel=2e-4)
