"""A second fund of the same form is the same program: nothing is traced or compiled for it."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from tests.compilations import compilations
from tests.domains.pension import market_cases, people_cases, pots_cases
from tests.domains.same_form import PAIRS, same_programs

from snapo.case.given import CaseInput
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.domains.pension.market.assets.bond import Bond, CouponBond
from snapo.domains.pension.pots.simulator import simulator_of
from snapo.domains.pension.records.assets import AssetGroup
from snapo.domains.pension.records.case import ObjectiveTerm, PensionCase
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability, Revaluation
from snapo.domains.pension.results.setup import make_setup, setup_at
from snapo.engine.native.call import _runners
from snapo.problem.problem import Problem
from snapo.solver.learning.optimiser import schedule

STEPS = 3
SEEN = ("time", "funding_ratio", "rates", "inflation", "weights")
QUICK = {
    "training": TrainingTable(steps=2, paths=64, validation_paths=64),
    "evaluation": EvaluationTable(paths=128, sensitivity_paths=64, judge_paths=0, search_paths=0),
    "objective": (ObjectiveTerm(1.0, "funding_ratio", ObjectiveTable(kind="mean")),),
}
BASES = (
    Liability("risk-free", people_cases.given("liability_rate", 0.01), "none"),
    Liability("spread", people_cases.given("liability_rate", 0.01), "full", annual=True),
    Liability("fixed", people_cases.given("liability_rate", 0.01), "none"),
)
PLANS: tuple[dict[str, Any], ...] = (
    {"indexation": people_cases.indexing(), "open": True, "entry_age": 25.5},
    {
        "indexation": people_cases.indexing("fixed", rate=people_cases.given("rate", 0.01)),
        "revaluation": Revaluation(
            people_cases.given("old", 0.02), people_cases.given("new", 0.03)
        ),
        "timing": "arrears",
        "fractional_ages": "uniform",
    },
    {"indexation": people_cases.indexing("none"), "spouse_share": people_cases.nothing("share")},
)


def other_numbers(case: PensionCase, draw: np.random.Generator) -> PensionCase:
    """The same fund with every number moved, whether it is an input or not."""

    def moved(leaf: Any) -> Any:
        if isinstance(leaf, CaseInput):
            return replace(leaf, values=leaf.values * draw.uniform(0.97, 1.0, leaf.values.shape))
        whole = not isinstance(leaf, float | np.ndarray) or np.asarray(leaf).dtype.kind != "f"
        return leaf if whole else leaf * draw.uniform(0.97, 1.0, np.shape(leaf))

    return jax.tree.map(moved, case)


def fund(draw: np.random.Generator) -> PensionCase:
    """A fund of promised rights: its rules are drawn from a few."""
    kinds = [market_cases.CASH, market_cases.EQUITY, Bond("Bond", maturity=2, eligible=0.9)]
    kinds += [CouponBond("Coupons", maturity=3, coupon=0.02)]
    held = market_cases.assets(
        STEPS, kinds, mean=[0.03], volatility=[0.2], weight=[0.2, 0.3, 0.2, 0.3],
        groups=(AssetGroup("bonds", (2, 3), 0.2, 0.7),),
    )  # fmt: skip
    if draw.integers(2):
        held = replace(held, max_sale=np.array([np.inf, 0.5, np.inf, 0.3]), turnover=0.6)
    plan = people_cases.plan(**PLANS[draw.integers(3)])
    fields = {
        "assets": held,
        "plan": plan,
        "liability": BASES[draw.integers(3)],
        "step": 1.0,
        "observation": SEEN,
        "lee_carter": people_cases.lee_carter() if draw.integers(2) else None,
        "held": ("mortality_multiplier", "assets"),
    }
    return replace(people_cases.people_case(STEPS), **fields)


def pots(draw: np.random.Generator) -> PensionCase:
    """A fund of personal pots."""
    timing = str(draw.choice(["advance", "arrears"]))
    return replace(pots_cases.fund(STEPS, 1.0, timing=timing), liability=BASES[draw.integers(2)])


MAKERS = {"fund": fund, "pots": pots}


def drawn(kind: str, seed: int) -> Problem:
    """A problem whose every number is drawn, and its rules of a few."""
    draw = np.random.default_rng(seed)
    case = other_numbers(MAKERS[kind](draw), draw)
    return Problem(simulator_of(case), pension_inputs(case), "funding_ratio")


@PAIRS
@pytest.mark.parametrize("kind", MAKERS)
def test_equal_forms_are_equal_programs(kind, enough):
    assert same_programs((drawn(kind, seed) for seed in range(4000)), enough) >= enough


@pytest.mark.parametrize("kind", MAKERS)
def test_a_simulator_has_arrays_alone(kind):
    simulator = drawn(kind, 0).simulator
    leaves = jax.tree.leaves(simulator)
    assert leaves and all(isinstance(leaf, np.ndarray) for leaf in leaves)
    assert not hasattr(simulator, "case") and not jax.tree.leaves(simulator.on_paths())


@pytest.mark.parametrize(
    "kind",
    [pytest.param("fund", marks=pytest.mark.prove), pytest.param("pots", marks=pytest.mark.study)],
)
def test_a_second_fund_compiles_nothing_and_has_its_own_bits(kind):
    """Members are older; assets, bounds, costs and curves are others."""
    draw = np.random.default_rng(1)
    first = other_numbers(replace(MAKERS[kind](draw), **QUICK), draw)
    second = other_numbers(first, np.random.default_rng(0))
    setup = make_setup(first, "native")
    before = setup.solve()
    # The verdict sums the rates of all steps, where a training gained: not in every one.
    schedule(setup.training)(np.arange(setup.training.steps))
    with compilations() as compiled:
        after = make_setup(second, "native").solve()
        moved = setup_at(setup, second, "native").problem.schedule
    assert compiled == []
    jax.clear_caches()
    _runners.clear()
    again = make_setup(second, "native")
    assert jax.tree.all(jax.tree.map(np.array_equal, moved, again.problem.schedule))
    alone = again.solve()
    assert after.value == alone.value != before.value
    assert jax.tree.all(jax.tree.map(np.array_equal, after.policy, alone.policy))


@pytest.mark.prove
def test_another_form_is_made_anew():
    first = market_cases.full(3)
    other = replace(first, liability=BASES[2])
    moved = setup_at(make_setup(first), other, "auto")
    assert moved.problem.form == Problem(simulator_of(other), pension_inputs(other), "assets").form
    assert moved.case is other
