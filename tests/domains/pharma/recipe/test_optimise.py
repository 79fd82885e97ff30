"""The best recipe: conditions against closed forms, shadow prices against solving again."""

import tomllib
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import CASE, LOOP, SMALLER

from snapo.case.error import CaseError
from snapo.domains.pharma.flowsheet.process import PharmaProcess
from snapo.domains.pharma.read.case import read_case, resolve
from snapo.domains.pharma.recipe.optimise import optimise, varies
from snapo.domains.pharma.recipe.optimum import ACTIVE, SearchLimits, TracedRecipe, best, optimum

EXAMPLE = Path(__file__).parents[4] / "examples" / "plug_flow"


def test_a_quadratic_with_its_multipliers():
    """(x - 2)^2 + (y - 1)^2 + (z - 5)^2, x + y <= 2, z <= 4: (1.5, 0.5, 4), multipliers 1 and 2."""

    def function(x):
        goal = (x[0] - 2) ** 2 + (x[1] - 1) ** 2 + (x[2] - 5) ** 2
        return jnp.stack([goal, 2 - x[0] - x[1]])

    for mode in ("adjoint", "forward"):
        traced = TracedRecipe(function, mode)
        found = optimum(traced, [0, 0, 0], [-3, -3, -3], [4, 4, 4], sense=-1, scale=10.0)
        assert found.converged and traced.compiling > 0
        assert found.x == pytest.approx([1.5, 0.5, 4.0], abs=1e-7)
        assert found.value == pytest.approx(1.5) and found.gradient[2] == pytest.approx(-2)
        assert found.conditions.above == pytest.approx([1.0], rel=1e-6)
        assert found.conditions.high == pytest.approx([0, 0, 2.0], rel=1e-6)
        assert not found.conditions.low.any()


def test_an_equality_may_pull_either_way():
    """x y with x + y = 1: 1/4, and the multiplier of the equality is minus what it is worth."""
    found = best(
        lambda x: x[0] * x[1], np.array([0.2, 0.3]), np.zeros(2), np.ones(2),
        equality=lambda x: x[0] + x[1] - 1,
    )  # fmt: skip
    assert found.converged and found.value == pytest.approx(0.25)
    assert found.conditions.equal == pytest.approx([-0.5], rel=1e-6)


def test_what_is_no_optimum_does_not_count_as_one(monkeypatch):
    """A solver that stops at once leaves its gradient unexplained, and the residual says so."""
    monkeypatch.setattr("snapo.domains.pharma.recipe.optimum._solve", lambda problem, u: (u, 0))
    found = best(lambda x: -jnp.sum((x - 0.5) ** 2), np.array([0.2]), np.zeros(1), np.ones(1))
    assert not found.converged and found.residual == pytest.approx(0.6)
    # At a bound that it could leave for the better, the multiplier has the wrong sign.
    edge = best(lambda x: -jnp.sum((x - 0.5) ** 2), np.array([0.0]), np.zeros(1), np.ones(1))
    assert not edge.converged and edge.conditions.low == pytest.approx([0.0])


def rosenbrock(x):
    """Least, 0, at (1, 1)."""
    return (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"evaluations": 5}, "it stopped after 5 evaluations before the tolerance 1e-06"),
        (
            {"seconds": 0.0},
            "it stopped after 0 s before the tolerance 1e-06 was reached: stationarity",
        ),
    ],
)
def test_an_optimisation_stops_at_its_limit_and_says_so(limits, words):
    lines = []
    told = SearchLimits(progress=lines.append, **limits)
    start, ends = np.array([-1.2, 1.0]), (np.full(2, -2.0), np.full(2, 2.0))
    found = best(rosenbrock, start, *ends, sense=-1, limits=told)
    assert not found.converged and words in found.message and found.evaluations <= 6
    assert found.value <= rosenbrock(start)  # the best point seen
    assert lines[0].startswith("evaluation 1: goal 24.2, largest violation 0")
    whole = best(rosenbrock, start, *ends, sense=-1)
    assert whole.converged and whole.message == "converged"
    assert whole.x == pytest.approx([1, 1], abs=1e-5)


def test_a_function_that_is_not_a_number_somewhere_leaves_the_best_point():
    """sqrt(x - 0.5) has no value below 0.5, where its minimum would be."""
    found = best(
        lambda x: jnp.sqrt(x[0] - 0.5) + x[0] ** 2, np.array([0.9]), np.zeros(1), np.ones(1),
        sense=-1,
    )  # fmt: skip
    assert not found.converged and np.isfinite(found.value) and found.x[0] <= 0.9
    assert "the function is not a number after" in found.message


def test_a_tolerance_is_the_callers():
    start, ends = np.array([-1.2, 1.0]), (np.full(2, -2.0), np.full(2, 2.0))
    limits = SearchLimits(evaluations=12)
    loose = best(rosenbrock, start, *ends, sense=-1, tolerance=1e3, limits=limits)
    assert loose.converged and loose.evaluations <= 12


def reactor(**changes):
    """The small case: product per hour, its temperature and duration chosen."""
    data = tomllib.loads(CASE) | tomllib.loads(LOOP.replace('"15 min"', '"5 min"'))
    data = {k: v for k, v in data.items() if k not in (*SMALLER, "control", "training")}
    data["optimise"] |= changes
    return resolve(EXAMPLE / "case.toml", data)


@pytest.mark.prove
def test_a_limit_is_worth_what_solving_again_gains():
    """Product per hour wants a short batch; the least product, 0.11 mol/L, holds it."""
    case = reactor()
    found = optimise(PharmaProcess(case))
    assert found.recipe.converged and found.recipe.residual < 1e-6
    temperature, duration = found.recipe.x
    assert temperature == pytest.approx(323.15)
    # A limit counts as reached within 1e-7; how close an optimiser comes differs between machines.
    assert found.recipe.value == pytest.approx(0.11 / (duration / 3600), rel=ACTIVE)
    worth = found.recipe.conditions.above[0] / found.bounds[0].size
    step, ends = 1e-4, []
    for limit in (0.11 - step, 0.11 + step):
        first = replace(case.attributes[0], low=limit)
        moved = replace(case, attributes=(first, *case.attributes[1:]))
        ends.append(optimise(PharmaProcess(moved)).recipe.value)
    assert worth == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)


def test_a_reserve_stays_within_the_limit():
    case = reactor(reserve=1.0)
    _, duration = (found := optimise(PharmaProcess(case))).recipe.x
    product = found.recipe.value * duration / 3600
    assert product == pytest.approx(0.11 + case.attributes[0].margin, rel=1e-9)


@pytest.mark.prove
def test_deviations_of_the_batches_stay_within_the_limit():
    case = reactor(deviations=0.3)
    process = PharmaProcess(case)
    found = optimise(process)
    sigma = varies(process)
    product = found.recipe.value * found.recipe.x[1] / 3600
    assert sigma[0] > 1e-4 and product == pytest.approx(0.11 + 0.3 * sigma[0], rel=1e-9)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("terms", [{"of": "reactor.concentration.X"}], "there is no such measure or number"),
        ("terms", [{"of": "reactor.duration", "unit": "mol"}], "optimise.terms[0].unit"),
        ("decisions", [{"of": "reactor.speed", "low": 1, "high": 2}], "there is no such number"),
        (
            "decisions",
            [{"of": "reactor.duration", "low": "2 h", "high": "3 h"}],
            "the number in the case, 1 h, is the start, and must be within the bounds",
        ),
        (
            "decisions",
            [{"of": "reactor.duration", "low": "2 h", "high": "1 h"}],
            "high must be above low",
        ),
        (
            "decisions",
            [{"of": "reactor.duration", "low": "30 min", "high": "2 h"}] * 2,
            "this number is decided twice",
        ),
        ("starts", 0, "a whole number from 1 to 1,000"),
    ],
)
def test_mistakes_are_named(key, value, words):
    with pytest.raises(CaseError) as caught:
        reactor(**{key: value})
    assert words in str(caught.value) and "optimise" in str(caught.value)


@pytest.mark.prove
def test_the_example_flowsheet():
    """Six decisions, two starts, one answer; conditions hold and multipliers have their signs."""
    found = optimise(PharmaProcess(read_case(EXAMPLE)))
    recipe = found.recipe
    assert recipe.converged and recipe.conditions.stationarity < 1e-6
    assert np.ptp(found.endpoints) < 1e-6 * recipe.value and recipe.value > 1.5 * found.before
    multipliers = np.concatenate(
        [recipe.conditions.low, recipe.conditions.high, recipe.conditions.above]
    )
    assert multipliers.min() >= 0 and multipliers.max() > 0
    # What has a multiplier is active: complementary slackness.
    assert np.max(np.abs(recipe.conditions.above * recipe.constraints)) < 1e-9
