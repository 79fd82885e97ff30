"""A price in a calm or tight market: forward, regimes, derivatives in the mean, and a store on it."""

import datetime

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.domains.gas_storage.storage_cases import bare, read

from snapo.domains.gas_storage.chapters.certificate import off_ties
from snapo.domains.gas_storage.contract.schedule import of_prices
from snapo.domains.gas_storage.policy.network import StoragePolicy
from snapo.domains.gas_storage.setup import bare_problem, make_setup
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.inputs import plain
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver import certificate
from snapo.solver.evaluate import evaluate

REGIMES = {
    "kind": "regimes",
    "mean_reversion": 12.0,
    "volatility": 0.6,
    "tightens": 0.05,
    "eases": 0.2,
    "premium": 0.4,
}
EARLIER = {"valuation_date": datetime.date(2024, 12, 22)}  # ten days before the first decision


def case(**model):
    return read("quick", model=REGIMES | model, market=EARLIER)


def tight_after(days, up=0.05, down=0.2):
    """The probability of a tight market, from a calm one: the closed form of a chain of two."""
    return up / (up + down) * (1 - (1 - up - down) ** np.asarray(days))


def paths_of(case, paths, seed=3):
    """Schedule and spot prices [T, paths], with the states of simulated paths."""
    simulator, _, schedule = bare(case)
    draws = Pseudo(seed).draws(np.arange(paths), simulator)
    nothing = np.zeros((simulator.horizon, paths, 2))
    rolled = Native("float64").values(
        simulator, None, schedule, draws, Exact(), actions=nothing, record=("state",)
    )
    state, row = rolled.record["state"].price, schedule.steps.price
    log = row.loading[:, None] * state.factor - row.variance[:, None] / 2
    log = log + schedule.constants.price.premium * state.tight - row.compensator[:, None]
    return schedule, row.forward[:, None] * np.exp(log), state


def test_the_spot_price_is_the_forward_price_on_average():
    count = 65536
    schedule, spots, _ = paths_of(case(), count)
    error = spots.std(1) / np.sqrt(count)
    assert np.all(np.abs(spots.mean(1) - schedule.steps.forward) < 4.5 * error)


def test_regimes_come_as_often_as_their_chain_says():
    count = 65536
    _, _, state = paths_of(case(), count)
    days = 10 + np.arange(len(state.tight))
    expected = tight_after(days)
    error = np.sqrt(expected * (1 - expected) / count)
    assert np.all(np.abs(state.tight.mean(1) - expected) < 4.5 * error)
    eased = np.mean(state.tight[1:][state.tight[:-1] == 1] == 0)
    assert abs(eased - 0.2) < 4.5 * np.sqrt(0.2 * 0.8 / np.sum(state.tight[:-1]))
    assert np.all(state.weight == 1)


def test_the_compensator_is_the_logarithm_of_the_expectation():
    schedule = bare(case())[2]
    days = 10 + np.arange(len(schedule.steps.price.compensator))
    assert_allclose(
        schedule.steps.price.compensator, np.log1p(tight_after(days) * np.expm1(0.4)), rtol=1e-12
    )


def test_without_a_gap_the_first_price_is_known():
    schedule, spots, _ = paths_of(read("quick", model=REGIMES), 16)
    assert_allclose(spots[0], schedule.steps.forward[0], rtol=1e-12)


@pytest.mark.prove
@pytest.mark.parametrize("make", [Native, Xla])
def test_every_derivative_agrees_with_differences(make):
    """But for those with respect to the probabilities, which are right in the mean alone."""
    problem = off_ties(bare_problem(case()))
    assert set(problem.in_mean) == {"tightens", "eases"}
    policy = StoragePolicy(problem.features, key=jax.random.key(0))
    bumps = certificate.certify_derivatives(problem, policy, paths=64, engine=make("float64"))
    assert "premium" in {bump.input for bump in bumps}
    wrong = [bump for bump in bumps if not bump.passed]
    assert not wrong, "\n".join(map(str, wrong))


@pytest.mark.prove
def test_the_derivative_with_respect_to_a_probability_is_that_of_the_closed_form():
    """That of the probability of a tight market on every day, by the likelihood ratio of paths."""
    simulator = bare(case())[0]
    days = 10 + np.arange(simulator.horizon)
    step = 1e-6
    expected = (tight_after(days, up=0.05 + step) - tight_after(days, up=0.05 - step)) / (2 * step)
    count = 65536
    rng = np.random.default_rng(4)
    first, later = (rng.standard_normal((*n, count, 2)) for n in ((), (simulator.horizon,)))
    process, inputs = simulator.process, plain(bare(case())[1])

    with jax.enable_x64(True):

        def one(up, initial, noise):
            made = process.prepare(inputs | {"tightens": up})

            def day(state, at):
                row, normals = at
                after = process.step(made.constants, row, state, normals)
                return after, process.weight(state) * state.tight

            rows = jax.tree.map(lambda leaf: leaf[: len(noise)], made.steps)
            state = process.initial(made.constants, initial)
            return jax.lax.scan(day, state, (rows, noise))[1]

        slope = jax.jacfwd(one)
        up = np.asarray(inputs["tightens"])
        found = jax.jit(jax.vmap(lambda a, b: slope(up, a, b), (0, 1)))(first, later)
    found = np.asarray(found).reshape(count, -1)
    error = found.std(0) / np.sqrt(count)
    assert np.all(np.abs(found.mean(0) - expected) < 4.5 * error + 1e-12)


@pytest.mark.prove
def test_without_a_premium_it_is_the_one_factor_price():
    calm = {key: REGIMES[key] for key in ("mean_reversion", "volatility")} | {"kind": "one-factor"}
    other = read("quick", model=calm, market=EARLIER)
    factors = bare(other)[0].process.factors(of_prices(bare(other)[2]))
    ours = bare(case(premium=0.0))[0].process.factors(of_prices(bare(case(premium=0.0))[2]))
    assert ours.exact is False and factors.exact
    for one, two in zip(ours[:4], factors[:4], strict=True):
        # The decay into the first day multiplies zeros.
        assert_allclose(one[1:], two[1:], rtol=1e-12)


@pytest.mark.prove
def test_a_store_earns_the_regimes():
    """The same rule earns more in a market that tightens, many standard errors."""
    values = {}
    for premium in (0.0, 1.5):
        made = make_setup(case(premium=premium), "native")
        engine = made.engines.evaluate
        values[premium] = evaluate(made.problem, made.policy.value_rule, paths=32768, engine=engine)
    calm, tight = values.values()
    assert tight.value - calm.value > 5 * np.hypot(calm.standard_error, tight.standard_error)
