"""Least-squares Monte Carlo out of sample against the exact values of G1, G6 and D6."""

import numpy as np
import pytest
from tests.domains.gas_storage.ladder.monthly import (
    factors,
    mean,
    paired,
    path_curves,
    schedule,
)
from tests.domains.gas_storage.storage_cases import bare, read

from snapo.domains.gas_storage.bounds.basis import gaussian_basis
from snapo.domains.gas_storage.bounds.relaxation import StoreRelaxation
from snapo.domains.gas_storage.contract.schedule import of_prices
from snapo.domains.gas_storage.ladder import methods
from snapo.domains.gas_storage.ladder.forwards import PathCurves, drawn_states
from snapo.domains.gas_storage.ladder.methods import DeskMethods, fitted_rule, followed
from snapo.domains.gas_storage.ladder.products import usual_products
from snapo.domains.gas_storage.ladder.store import FlatStore
from snapo.domains.gas_storage.setup import bare_problem


@pytest.mark.parametrize(("cost", "value"), [(0.0, 16.8766), (0.6, 13.1315)])
def test_the_best_policy_of_the_month_forwards(cost, value):
    """D6: at most three errors above the exact value, and at most half a percent below."""
    store, training = FlatStore(schedule(cost), "linear"), path_curves(4000, 1)
    basis = gaussian_basis(factors(), priced=False)
    rule = fitted_rule(store, basis, training.states, training.spots)
    others = path_curves(40_000, 2)
    ours, sampling = mean(paired(followed(rule, others.states, others.spots).money))
    assert value * 0.995 - 3 * sampling < ours < value + 3 * sampling


@pytest.mark.prove
@pytest.mark.parametrize(
    ("name", "trained", "low", "exact"),
    [("G6", 4096, 656.15 * 0.995, 656.15), ("G1", 2000, 77_800.0, 78_370.0)],
)
def test_stores_out_of_sample(monkeypatch, name, trained, low, exact):
    """With the penalties of the bound, whose mean is zero, as control variate."""
    monkeypatch.setattr(methods, "TRAINED", trained)
    case = read(name)
    simulator, _, plain = bare(case)
    prices = simulator.process.factors(of_prices(plain))
    curve = np.append(plain.steps.forward, plain.constants.end_forward)
    curves = PathCurves(prices, curve, drawn_states(prices, 512, 2))
    desk = DeskMethods(
        FlatStore(plain, case.contract.ratchets.interpolation),
        usual_products(case.days, case.valuation_date),
        curve,
        prices,
        curves.states,
        curves.spots,
        seed=0,
    )
    money, levels = desk.least_squares()
    inner = StoreRelaxation(bare_problem(case)).inner
    ours, sampling = mean(paired(money - inner.charged(levels, curves.states)))
    assert low + 3 * sampling < ours < exact + 3 * sampling + 0.0002 * exact
    assert levels.min() > -1e-9 and np.max(np.abs(levels[-1])) < 1e-6
