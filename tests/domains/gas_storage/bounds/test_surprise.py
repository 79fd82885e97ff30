"""The surprises of a fitted value: expected in closed form, of mean zero, and nobody's derivative."""

import jax
import numpy as np
import pytest
from tests.domains.gas_storage.bounds.test_basis import correlated, paths
from tests.domains.gas_storage.storage_cases import read

from snapo.domains.gas_storage.bounds.basis import gaussian_basis
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup
from snapo.engine import TRAJECTORY
from snapo.problem.smooth import Exact
from snapo.solver.evaluate import estimate, path_totals

TWO_FACTORS = {
    "kind": "multi-factor",
    "mean_reversion": None,
    "volatility": None,
    "factors": [
        {"mean_reversion": 12.0, "volatility": 0.6},
        {"mean_reversion": 3.0, "volatility": 0.3},
    ],
    "correlation": [[1.0, 0.3], [0.3, 1.0]],
}


def test_what_is_expected_of_a_polynomial_is_what_the_basis_expects():
    of = correlated()
    basis, states = gaussian_basis(of, True), paths(of, 64)
    assert basis._moves.shape[-1] > 1  # correlated: not one number for each function
    size = len(basis.powers)
    assert not basis.common  # and so no constant beside them
    after = np.random.default_rng(1).normal(size=(len(of.decay) - 1, 3, size))
    ahead = basis.expected_coefficients(after)
    seen = basis.functions(states)[:-1, :size]
    expected = basis.expected(states[:-1])[:, :size]
    np.testing.assert_allclose(ahead @ seen, after @ expected, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def setup():
    case = read("quick", model=TWO_FACTORS)
    return make_setup(case, "native", fitted_value(bare_problem(case)))


@pytest.mark.prove
def test_the_surprises_explain_nearly_all_of_the_scatter(setup):
    problem, engine = setup.problem, setup.engines.evaluate
    assert problem.simulator.control_variates() == ("value_surprise",)
    totals = path_totals(problem, setup.policy, 4096, engine=engine)
    source, controls = problem.sources.evaluation, ("value_surprise",)
    found = estimate(problem.objective, totals, source, controls)
    plain = estimate(problem.objective, totals, source)
    assert found.refused == () and found.standard_error < plain.standard_error / 5
    assert abs(found.value - plain.value) < 4 * plain.standard_error


@pytest.mark.prove
def test_the_surprises_have_no_derivative(setup):
    problem = setup.problem
    draws = problem.sources.evaluation.draws(np.arange(8), problem.simulator)
    bound, weights = setup.engines.evaluate.bind(problem), {"value_surprise": np.ones(8)}
    weights |= {"cash_flow": np.zeros(8)}
    found = bound.adjoint(setup.policy, draws, Exact(), weights)
    for leaf in jax.tree.leaves((found.policy, found.schedule)):
        assert not np.any(leaf)
    # Data in the schedule has a derivative all the same, and it is zero.
    assert found.schedule.steps.innovation.now.coefficients.shape == (
        problem.simulator.horizon,
        16,
        15,
    )


@pytest.mark.prove
def test_without_its_control_variates_a_path_is_the_same(setup):
    problem = setup.problem
    draws = problem.sources.evaluation.draws(np.arange(64), problem.simulator)
    engine = setup.engines.evaluate
    whole = engine.bind(problem).values(setup.policy, draws, Exact(), record=TRAJECTORY)
    bare = engine.bind(problem, controls=False)
    found = bare.values(setup.policy, draws, Exact(), record=TRAJECTORY)
    assert set(whole.totals) - set(found.totals) == {"value_surprise"}
    for name, total in found.totals.items():
        np.testing.assert_array_equal(total, whole.totals[name])
    for kind in ("state", "action", "slack"):
        jax.tree.map(np.testing.assert_array_equal, found.record[kind], whole.record[kind])
