"""The store of known prices: never too low, whatever the grid and whatever the penalty."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.gas_storage.bounds.test_basis import paths
from tests.domains.gas_storage.references import reference_schedules as cases

from snapo.domains.gas_storage.bounds.relaxation import Hindsight
from snapo.domains.gas_storage.bounds.value_iteration import FittedValue, fit_value
from snapo.domains.gas_storage.references.day_terms import end_value, unit_prices
from snapo.domains.gas_storage.references.intrinsic import intrinsic
from snapo.domains.gas_storage.references.lattice import lattice
from snapo.domains.gas_storage.references.piecewise import PiecewiseLine, day_value, visited

SHORT = cases.dated_ratchets()  # G3: sixteen days, ratchets that change
EXACT = 24_808.2  # with volumes between the extremes


def spots_of(schedule, states: np.ndarray) -> np.ndarray:
    """[T + 1, paths] spot prices; 0 on the end date, where none is needed."""
    of = schedule.factors
    noise = np.exp(np.einsum("tf,tfp->tp", of.loading, states) - of.variance[:, None] / 2)
    return np.append(schedule.steps.forward, 0.0)[:, None] * noise


def wild(schedule, inventories: int, seed: int) -> FittedValue:
    """A value function of nonsense: noise of the size of the value."""
    fitted = fit_value(schedule, schedule.factors, "linear", inventories)
    random = np.random.default_rng(seed)
    noise = [EXACT / 20 * random.standard_normal(each.shape) for each in fitted.coefficients]
    return replace(fitted, coefficients=noise)


def exactly(inner: Hindsight, spots: np.ndarray, states: np.ndarray) -> np.ndarray:
    """[paths] the same problem by exact piecewise-linear dynamic programming, path by path."""
    schedule, found = inner.schedule, []
    low, high = visited(schedule, "linear")
    surprises = inner._surprises(states, 1.0)
    assert surprises is not None and inner.coefficients is not None
    for p in range(spots.shape[1]):
        nodes = inner.grids[-1]
        line = PiecewiseLine(nodes, end_value(schedule, nodes, 0.0))
        for t in reversed(range(len(schedule.steps.forward))):
            nodes = inner.grids[t + 1]
            charge = inner.coefficients[t + 1] @ surprises[t + 1, :, p]
            at = np.union1d(line.at, nodes)
            at = at[np.append(True, np.diff(at) > 1e-9)]
            line = PiecewiseLine(at, line(at) - np.interp(at, nodes, charge))
            prices = unit_prices(schedule, t, spots[t, p])
            line = day_value(schedule, "linear", t, prices, line, low[t], high[t])
        found.append(line.value[0] - inner.coefficients[0][0] @ surprises[0, :, p])
    return np.array(found)


def test_at_forward_prices_it_is_the_intrinsic_value_from_above():
    forward = np.append(SHORT.steps.forward, 0.0)[:, None]
    states = np.zeros((len(forward), 1, 1))
    found = [Hindsight(SHORT, "linear", None, n).best(forward, states)[0] for n in (6, 11, 21, 41)]
    value = intrinsic(SHORT, "linear").value
    assert np.all(np.diff(found) <= 1e-6), "halving the grid raised the bound"
    assert found[-1] >= value - 1e-6
    assert found[-1] == pytest.approx(value, rel=1e-4)


@pytest.mark.parametrize("inventories", [6, 11, 21])
def test_no_penalty_makes_it_lower_than_exact(inventories):
    states = paths(SHORT.factors, 8, seed=3)
    spots = spots_of(SHORT, states)
    inner = Hindsight(SHORT, "linear", wild(SHORT, 11, seed=1), inventories)
    found, exact = inner.best(spots, states), exactly(inner, spots, states)
    assert np.all(found >= exact - 1e-6)


def test_a_finer_grid_does_not_raise_the_bound():
    states = paths(SHORT.factors, 64)
    spots, fitted = spots_of(SHORT, states), fit_value(SHORT, SHORT.factors, "linear", 21)
    found = [Hindsight(SHORT, "linear", fitted, n).best(spots, states).mean() for n in (21, 41, 81)]
    # The penalty of a finer grid is the same line, and its bends are met at nodes.
    assert np.all(np.diff(found) <= 1e-6 * EXACT)


@pytest.mark.parametrize(
    "case",
    [(SHORT, "linear", EXACT), (cases.calls(), "linear", 10_447.3037)],
    ids=["ratchets", "calls"],
)
def test_the_bound_of_one_factor_lies_just_above_the_exact_value(case):
    schedule, kind, exact = case
    fitted = fit_value(schedule, schedule.factors, kind, 31)
    states = paths(schedule.factors, 128)
    found = Hindsight(schedule, kind, fitted, 31).best(spots_of(schedule, states), states)
    pairs = (found[:64] + found[64:]) / 2
    error = pairs.std(ddof=1) / 8
    assert -3 * error <= pairs.mean() - exact <= 0.001 * exact + 3 * error
    assert fitted.value == pytest.approx(exact, rel=0.001)


def test_with_step_ratchets_the_bound_is_wide_and_holds():
    schedule = cases.dated_ratchets("step")
    exact = lattice(schedule, schedule.factors, "step").value
    fitted = fit_value(schedule, schedule.factors, "step", 61)
    states = paths(schedule.factors, 64)
    found = Hindsight(schedule, "step", fitted, 61).best(spots_of(schedule, states), states)
    assert exact <= found.mean() <= 1.02 * exact


@pytest.mark.parametrize("wrong", ["twice", "noise", "upside down"])
def test_a_wrong_value_function_gives_a_wide_bound_and_never_a_wrong_one(wrong):
    fitted = fit_value(SHORT, SHORT.factors, "linear", 21)
    tables = {
        "twice": [2.5 * each for each in fitted.coefficients],
        "noise": wild(SHORT, 21, seed=5).coefficients,
        "upside down": [-each[::-1] for each in fitted.coefficients],
    }
    states = paths(SHORT.factors, 256)
    spots = spots_of(SHORT, states)
    bad = replace(fitted, coefficients=tables[wrong])
    found = Hindsight(SHORT, "linear", bad, 21).best(spots, states)
    pairs = (found[:128] + found[128:]) / 2
    good = Hindsight(SHORT, "linear", fitted, 21).best(spots, states).mean()
    assert pairs.mean() >= EXACT - 3 * pairs.std(ddof=1) / np.sqrt(128)
    assert pairs.mean() - EXACT > 5 * (good - EXACT)


def test_the_charge_of_a_plan_without_foresight_has_mean_zero():
    states = paths(SHORT.factors, 1024)
    fitted = fit_value(SHORT, SHORT.factors, "linear", 21)
    inner = Hindsight(SHORT, "linear", fitted, 21)
    plan = intrinsic(SHORT, "linear").inventory[:, None] + np.zeros(1024)
    charged = inner.charged(plan, states)
    earned = _earned(SHORT, plan, spots_of(SHORT, states))
    pairs = (charged[:512] + charged[512:]) / 2
    assert abs(pairs.mean()) <= 3 * pairs.std(ddof=1) / np.sqrt(512)
    assert np.all(inner.best(spots_of(SHORT, states), states) >= earned - charged - 1e-6)


def _earned(schedule, plan, spots):
    """[paths] earnings of an inventory plan without losses."""
    total = np.zeros(spots.shape[1])
    for t, net in enumerate(np.diff(plan, axis=0)):
        prices = unit_prices(schedule, t, spots[t])
        total -= np.where(net > 0, net * prices.pay, net * prices.earn)
    return total
