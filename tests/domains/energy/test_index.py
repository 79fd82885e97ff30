"""A strike that follows the month-ahead index, against the exact numbers of D10."""

import datetime
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.energy.energy_cases import HOME, case_at, exact, plain

from snapo.case.error import CaseError
from snapo.domains.energy.chapters.ladder import no_flat_volumes
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.methods.lattice import lattice
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate

SLOW = 33  # nodes of the index: 17 are 0.02 % off
D10 = {
    "contract.strike": {"index": "month-ahead", "factor": 1.0, "add": 0.25},
    "contract.annual": {"min": 150.0, "max": 250.0},
    "contract.shortfall": "firm",
    "model.mean_reversion": 10.0,
    "model.volatility": 0.8,
}
# Shared by tests of few days: three months from a valuation within a month.
LATE = {
    "market.valuation_date": datetime.date(2026, 10, 12),
    "contract.start": datetime.date(2026, 11, 1),
    "contract.end": datetime.date(2027, 1, 1),
    "contract.annual": {"min": 10.0, "max": 20.0},
}
KINDS = (
    {},
    {"model.kind": "one-factor-normal", "model.volatility": 25.0},
    {"model.kind": "one-factor-shifted", "model.shift": 20.0},
)


def indexed(**changes):
    """D10, with changed keys."""
    return case_at(HOME / "template_swing", D10 | changes)


def value(case, slow: int = SLOW) -> float:
    """On a lattice of factor and index."""
    problem = bare_problem(case)
    return lattice(case.contract.layout, problem.schedule, factors_of(problem), slow=slow).value


@pytest.mark.prove
def test_no_annual_limits():
    """D10: one exchange of spot and index a day, 492.16022 by quadrature."""
    case = indexed(**{"contract.annual": None})
    assert value(case) == pytest.approx(492.16022, abs=0.01)


def test_at_forward_prices():
    """D10: the index is then the mean of its month, and the minimum costs 36.618."""
    assert exact(indexed(), forward=True) == pytest.approx(-36.618, abs=1e-3)


@pytest.mark.prove
def test_take_or_pay_at_an_index():
    """D10: "exact", good to 0.02."""
    assert value(indexed()) == pytest.approx(481.35, abs=0.02)


@pytest.mark.study
@pytest.mark.parametrize(
    ("changes", "exact_value", "error"),
    [
        ({"contract.shortfall": 4.0}, 481.88, 0.03),
        ({"contract.annual": {"min": 200.0, "max": 200.0}}, 420.14, 0.02),
    ],
)
def test_other_limits_at_an_index(changes, exact_value, error):
    """D10, with the errors given there."""
    assert value(indexed(**changes)) == pytest.approx(exact_value, abs=error)


@pytest.mark.prove
def test_the_derivative_by_the_added_amount():
    """D10, exact to 0.5 %; 9 nodes of the index suffice."""
    strike = D10["contract.strike"]
    sides = [{"contract.strike": strike | {"add": x}} for x in (0.35, 0.15)]
    up, down = (value(indexed(**side), 9) for side in sides)
    assert (up - down) / 0.2 == pytest.approx(-176.9, rel=5e-3)


@pytest.mark.prove
def test_policy_and_bound_enclose_the_exact_value():
    """D10: the fitted rule within 0.15 % of 481.35, the bound within 0.5 %."""
    setup, best = make_setup(indexed(), "native"), 481.35
    problem, policy, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    rule = evaluate(problem, policy, paths=16384, engine=engine)
    assert rule.standard_error < 0.0005 * best
    assert 0.9985 * best <= rule.value + 3 * rule.standard_error
    assert rule.value <= best + 0.02 + 3 * rule.standard_error
    relaxation = EnergyRelaxation(problem)
    result = bound(problem, policy, relaxation=relaxation, engine=engine, paths=1024)
    # On the same paths, so that the error of their mean falls out.
    gap = result.upper.value - result.lower.value
    assert 0 < gap < 0.005 * best


@pytest.mark.prove
@pytest.mark.parametrize("model", KINDS)
def test_index_of_simulated_prices(model):
    """Its mean is that of the curve, and the factors have the covariance that programs read."""
    case = indexed(**LATE, **model)
    process, problem = bare_problem(case).simulator.process, bare_problem(case)
    with jax.enable_x64(True):
        inputs = {name: jnp.asarray(x.value) for name, x in problem.inputs_by_name.items()}
        schedule = jax.jit(process.prepare)(inputs)
        first, *rest = jax.random.normal(jax.random.key(0), (32, 20_000, process.noise_size))
        noise = jax.random.normal(jax.random.key(1), (20_000, process.initial_noise_size))
        state = jax.vmap(process.initial, (None, 0))(schedule.constants, noise)
        moments, rows = [], schedule.steps
        for t, draw in enumerate([first, *rest]):
            row = jax.tree.map(lambda leaf, t=t: leaf[t], rows)
            if t in (0, 29, 30):
                price = jax.vmap(process.index, (None, None, 0))(schedule.constants, row, state)
                moments.append(
                    (t, np.asarray(price), np.asarray(jax.vmap(process.gaussian)(state)))
                )
            state = jax.vmap(process.step, (None, None, 0, 0))(schedule.constants, row, state, draw)
    of = process.factors(plain(schedule))
    assert of.covariance[0, 1, 1] > 0  # fixed before the month
    for t, price, factors in moments:
        month = slice(0, 30) if t < 30 else slice(30, 61)
        error = price.std() / np.sqrt(len(price))
        assert abs(price.mean() - case.market.forward_curve.used()[month].mean()) < 4 * error
        assert np.allclose(np.cov(factors.T), of.covariance[t], rtol=0.05, atol=2e-4)
        assert np.allclose(of.index.price(of, t, factors[:, 1]), price, rtol=1e-12)


@pytest.mark.prove
def test_derivative_of_the_index():
    """Gradients of an index against central differences."""
    problem = bare_problem(indexed(**LATE, **KINDS[2]))
    process = problem.simulator.process
    with jax.enable_x64(True):
        inputs = {name: jnp.asarray(x.value) for name, x in problem.inputs_by_name.items()}
        noise = jax.random.normal(jax.random.key(1), (process.initial_noise_size,))

        @jax.jit
        def price(values):
            schedule = process.prepare(values)
            row = jax.tree.map(lambda leaf: leaf[0], schedule.steps)
            state = process.initial(schedule.constants, noise)
            return process.index(schedule.constants, row, state)

        slopes, step = jax.grad(price)(inputs), 1e-5
        for name in ("forward_curve", "volatility", "mean_reversion"):
            number = jnp.ravel(inputs[name])[0]
            sides = [
                price(inputs | {name: jnp.ravel(inputs[name]).at[0].set(number + x)})
                for x in (step, -step)
            ]
            slope = np.asarray(slopes[name]).ravel()[0]
            assert slope == pytest.approx(float(sides[0] - sides[1]) / (2 * step), rel=1e-6)


def test_value_is_proportional_to_the_curve(tmp_path):
    """Without an added amount: D10, "sum of F x delta = value"."""
    changes = D10 | LATE | {"contract.strike": {"index": "month-ahead"}}
    folder = shutil.copytree(HOME / "template_swing", tmp_path / "dear")
    head, *rows = (folder / "curve.csv").read_text().split()
    pairs = [row.split(",") for row in rows]
    dear = [f"{month},{1.25 * float(price)!r}" for month, price in pairs]
    (folder / "curve.csv").write_text("\n".join([head, *dear]))
    values = [value(case_at(place, changes), 9) for place in (HOME / "template_swing", folder)]
    assert values[1] == pytest.approx(1.25 * values[0], rel=1e-12)


@pytest.mark.prove
def test_a_month_that_has_begun_has_its_index():
    """Valued within October, its index is 26.5; without volatility the best days are fixed."""
    running = {
        "market.valuation_date": datetime.date(2026, 10, 20),
        "contract.end": datetime.date(2026, 12, 1),
        "contract.annual": None,
        "model.volatility": 0.0,
    }
    strike = {"index": "month-ahead", "factor": 0.9, "add": 0.25, "fixing": 26.5}
    case = indexed(**running, **{"contract.strike": strike})
    forward = case.market.forward_curve.used()
    index = np.where(np.arange(len(forward)) < 12, 26.5, forward[12:].mean())
    discount = np.exp(-0.03 * np.arange(len(forward)) / 365)
    plan = np.sum(discount * np.maximum(forward - 0.9 * index - 0.25, 0.0))
    assert value(case) == pytest.approx(plan, rel=1e-9)
    assert plan > 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"contract.strike": True}, "contract.strike: got true; it must be a number"),
        ({"contract.strike": {"index": "year"}}, 'strike.index: .*must be "month-ahead"'),
        ({"contract.strike": {"index": "month-ahead", "sum": 1.0}}, "strike.sum"),
        ({"contract.shortfall": "strike"}, "contract.shortfall: .*indexed strike"),
        ({"contract.start": datetime.date(2026, 10, 5)}, "contract.start: .*first day of a month"),
        ({"contract.end": datetime.date(2027, 9, 5)}, "contract.end: .*first day of a month"),
        ({"market.valuation_date": datetime.date(2026, 10, 5)}, "strike.fixing: .*specify it"),
        (
            LATE | {"contract.strike": {"index": "month-ahead", "fixing": 30.0}},
            "strike.fixing: .*is not fixed yet",
        ),
        (
            {
                "model.kind": "one-factor-jumps",
                "model.jump_intensity": 8.0,
                "model.jump_size": 0.3,
                "model.jump_mean_reversion": 100.0,
            },
            'model.kind: .*must be "one-factor"',
        ),
    ],
)
def test_mistakes_are_named(changes, words):
    with pytest.raises(CaseError, match=words):
        indexed(**changes)


def test_no_flat_volumes_at_an_index():
    assert "index" in no_flat_volumes(indexed().contract.layout)
