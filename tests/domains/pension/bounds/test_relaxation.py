"""The bound of a fund: on Merton's closed form, and above every policy where rules respond."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pension.fund.test_merton import EQUIVALENT, GAMMA, OBJECTIVE, WEIGHT, fund

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.bounds.relaxation import FundRelaxation, conjugate
from snapo.domains.pension.fund.simulator import PensionSimulator
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.setup import make_setup
from snapo.problem.objective import CRRA, CVaR, ExpectedUtility, Mean
from snapo.problem.policies.rules import Constant
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Pseudo, Sources
from snapo.solver.bound import bound


@pytest.fixture(scope="module")
def merton():
    one = fund()
    simulator, inputs = PensionSimulator.of(one), pension_inputs(one)
    problem = Problem(simulator, inputs, OBJECTIVE, Sources.of(Pseudo(3)))
    policy = Constant(np.array([1 - WEIGHT, WEIGHT]))
    return problem, policy, FundRelaxation(problem, policy, 512)


@pytest.mark.prove
def test_mertons_problem_is_certified_within_a_thousandth(merton):
    """The prices of risk of a month are not quite those of the best mix, so the gap is not zero."""
    problem, policy, relaxation = merton
    found = bound(problem, policy, relaxation=relaxation, paths=512)
    lower, upper = found.sure
    assert problem.objective.certainty_equivalent(found.lower.low) <= EQUIVALENT * (1 + 1e-8)
    assert problem.objective.certainty_equivalent(found.upper.high) >= EQUIVALENT
    assert lower < upper < 1.001 * lower


@pytest.mark.prove
def test_wrong_prices_are_wide_and_never_wrong(merton):
    problem, policy, relaxation = merton
    right = bound(problem, policy, relaxation=relaxation, paths=512).gap.value
    kept = relaxation.price
    try:
        for wrong in (0 * kept, 2 * kept):
            relaxation.price = wrong
            found = bound(problem, policy, relaxation=relaxation, paths=512)
            assert found.upper.high >= OBJECTIVE.utility(np.array([EQUIVALENT]))[0]
            assert found.gap.value > 3 * right
    finally:
        relaxation.price = kept


@pytest.mark.prove
def test_the_levered_mix_of_a_logarithm_is_certified_too():
    """Relative risk aversion 1: Merton's weight is 0.04 / 0.18^2, 123 % of the assets in shares,
    and the mean log growth 0.02 + 0.04^2 / (2 0.18^2) a year less what monthly steps lose."""
    one, logarithm = fund(), ExpectedUtility("assets", CRRA(1.0))
    weight = 0.04 / 0.18**2
    held = replace(one.assets, low=np.array([-1.0, 0.0]), high=np.array([1.0, 2.0]))
    simulator = PensionSimulator.of(replace(one, assets=held))
    problem = Problem(simulator, pension_inputs(one), logarithm, Sources.of(Pseudo(3)))
    policy = Constant(np.array([1 - weight, weight]))
    found = bound(problem, policy, relaxation=FundRelaxation(problem, policy, 512), paths=512)
    best = np.exp(10 * (0.02 + 0.04**2 / (2 * 0.18**2)))
    lower, upper = found.sure
    assert lower < upper < 1.002 * lower
    assert problem.objective.certainty_equivalent(found.upper.high) >= best * (1 - 1e-3)
    assert lower == pytest.approx(best, rel=0.01)


@pytest.mark.study
def test_a_fund_whose_rules_respond_is_bounded_path_by_path():
    """Indexation and contributions at their extremes: hindsight never earns less than a policy."""
    folder = DOMAIN.templates["small"]
    file = Path(str(folder)) / "case.toml"
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    data["fund"]["years"] = 1
    setup = make_setup(DOMAIN.read(file, data), "xla")
    relaxation = FundRelaxation(setup.problem, setup.policy, 128)
    found = bound(setup.problem, setup.policy, relaxation=relaxation, paths=128)
    assert 0.9 < found.sure[0] < found.sure[1] < 1.5
    with pytest.raises(ValueError, match="with perfect foresight"):
        bound(setup.problem, setup.policy, relaxation=relaxation, paths=128, penalty="none")


@pytest.mark.prove
def test_conjugates_are_the_most_over_a_grid():
    ratios = np.linspace(1e-3, 40, 400_001)
    prices = np.array([0.05, 0.3, 0.9, 1.4])
    for objective in (
        ExpectedUtility("funding_ratio", CRRA(GAMMA)),
        ExpectedUtility("assets", CRRA(1.0)),
        ExpectedUtility("funding_ratio", replace(CRRA(3.0), wealth=0.5)),
    ):
        most = [np.max(objective.utility(ratios) - z * ratios) for z in prices]
        np.testing.assert_allclose(conjugate(objective)(prices), most, rtol=1e-6, atol=1e-6)
    short = [np.max(np.minimum(ratios - 1, 0) - z * ratios) for z in prices]
    found = conjugate(Mean("surplus_ratio"))(prices)
    np.testing.assert_allclose(found, short, atol=2e-3)  # the grid begins at .001
    growth = [np.max(np.log(ratios / 1.1) - z * ratios) for z in prices]
    np.testing.assert_allclose(conjugate(Mean("log_relative"), 1.1)(prices), growth, atol=1e-6)


def test_other_objectives_are_refused():
    with pytest.raises(ValueError, match="has an upper bound for a utility"):
        conjugate(CVaR("funding_ratio", 0.95))
