"""A plant whose certificates of emissions have a price that moves."""

import datetime
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm
from tests.domains.energy.energy_cases import HOME, case_at, exact, plain, plant

from snapo.case.error import CaseError
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.methods.intrinsic import intrinsic_value
from snapo.domains.energy.methods.lattice import refined
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup, price_schedule
from snapo.domains.energy.summary import known_schedule
from snapo.engine.native import Native
from snapo.problem.smooth import EXACT
from snapo.solver.bound import bound
from snapo.solver.evaluate import evaluate
from snapo.solver.sensitivity import sensitivities
from snapo.testing.derivatives import wrong_derivatives

HOUR, END = 1 / 8760, datetime.datetime(2026, 1, 5, 12)
WEEK = datetime.datetime(2026, 1, 12)
MARKET = {
    "contract.emission": {"per_fuel": 1.0, "market": "co2"},
    "market.co2": {"forward_curve": "co2.csv"},
}
THREE = [["power", "gas", 0.4], ["co2", "gas", 0.3], ["power", "co2", -0.2]]


def of_template(folder):
    """The template in a folder, with certificates at 14 on every day."""
    shutil.copytree(HOME / "template_plant", folder)
    rows = [f"2026-01-{day:02d},14.0" for day in range(5, 12)]
    (folder / "co2.csv").write_text("\n".join(["date,price", *rows]))
    return folder


@pytest.fixture
def folder(tmp_path):
    return of_template(tmp_path / "case")


def with_market(folder, volatility, **changes):
    """Half a day of the template; keys of the case changed."""
    model = {"kind": "one-factor", "mean_reversion": 5.0, "volatility": volatility}
    keys = MARKET | {"contract.end": END, "model.co2": model, "model.correlation": THREE}
    return case_at(folder, keys | changes)


def test_covariance_of_a_step_is_exact(folder):
    """rho (1 - exp(-(a + b) h)) / (a + b) for each pair."""
    of = factors_of(bare_problem(with_market(folder, 0.5)))
    speeds = np.array([525.6, 20.0, 5.0])
    rho = np.array([[1, 0.4, -0.2], [0.4, 1, 0.3], [-0.2, 0.3, 1]])
    pair = speeds[:, None] + speeds
    covariance = rho * (1 - np.exp(-pair * HOUR)) / pair
    assert np.allclose(of.shock[5] @ of.shock[5].T, covariance, rtol=1e-12)
    assert np.all(of.loading[:, 1:] == 0)


def test_cost_of_fuel(folder):
    """Along a path and for dynamic programs: G + e C, each with its forward price as its mean."""
    changes = {"contract.emission": {"per_fuel": 0.2, "market": "co2"}}
    problem = bare_problem(with_market(folder, 0.5, **changes))
    process, schedule = problem.simulator.process, price_schedule(problem)
    row, state = jax.tree.map(lambda x: x[7], schedule.steps), np.array([0.3, -0.02, 0.05])
    with jax.enable_x64(True):
        cost = float(process.index(schedule.constants, row, jnp.asarray(state)))
    age, speeds, moves = 7 * HOUR, np.array([20.0, 5.0]), np.array([0.6, 0.5])
    variance = moves**2 * (1 - np.exp(-2 * speeds * age)) / (2 * speeds)
    prices = np.array([row.index.fuel.forward, 14.0]) * np.exp(moves * state[1:] - variance / 2)
    assert cost == pytest.approx(prices @ [1.0, 0.2], rel=1e-12)
    of = factors_of(problem)
    assert of.index.at(of, 7, state[:, None]) == pytest.approx(cost, rel=1e-12)
    expected = plain(schedule.steps.index.expected())
    assert expected[7] == pytest.approx(row.index.fuel.forward + 0.2 * 14.0, rel=1e-12)


@pytest.mark.parametrize("per_fuel", [0.2, 1.0])
def test_a_check_includes_certificates(per_fuel, folder):
    """At forward prices certificates at 14 cost as much as emissions at a fixed price of 14."""
    moving = {"contract.emission": {"per_fuel": per_fuel, "market": "co2"}, "contract.end": WEEK}
    fixed = plant(emission={"per_fuel": per_fuel, "price": 14.0})
    values = [
        intrinsic_value(case.contract.layout, known_schedule(case))
        for case in (with_market(folder, 0.5, **moving), fixed)
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-12, abs=1e-9)
    assert (values[1] > 1000.0) == (per_fuel < 1.0)


@pytest.mark.prove
def test_without_volatility_it_is_a_fixed_price(folder):
    """At forward prices and on the lattice."""
    case, fixed = with_market(folder, 0.0), plant(end=END)
    assert exact(case, forward=True) == pytest.approx(exact(fixed, forward=True), abs=1e-9)
    assert exact(case, finer=1) == pytest.approx(exact(fixed, finer=1), rel=1e-12)


def test_three_prices_have_no_lattice(folder):
    problem = bare_problem(with_market(folder, 0.5))
    with pytest.raises(ValueError, match="one or two price factors"):
        refined(problem.simulator.layout, problem.schedule, factors_of(problem))


@pytest.mark.prove
def test_exchange_of_power_for_certificates(folder):
    """Margrabe's formula: where gas is free, a strip without start costs is an option to exchange
    certificates for power in each hour. Value, and derivative by the price of certificates."""
    (folder / "gas.csv").write_text(
        "\n".join(["date,price", *(f"2026-01-{day:02d},0.000001" for day in range(5, 12))])
    )
    (folder / "co2.csv").write_text(
        "\n".join(["date,price", *(f"2026-01-{day:02d},40.0" for day in range(5, 12))])
    )
    changes = {
        "contract.starts": [], "contract.min_up": 1, "contract.min_down": 1,
        "contract.power": {"min": 0.0, "max": 110.0}, "contract.fuel": {"per_mwh": 2.0},
        "contract.other_cost": 0.0,
    }  # fmt: skip
    case = with_market(folder, 2.0, **changes)
    time, rates, moves = np.arange(12) * HOUR, np.array([525.6, 5.0]), np.array([11.2315, 2.0])
    power, cost = case.market.forward_curve.used(), 80.0
    pair = rates[:, None] + rates
    part = np.outer(moves, moves) * np.array([[1.0, 0.2], [0.2, 1.0]])
    variance = np.sum(part / pair * (1 - np.exp(-np.multiply.outer(time, pair))), (1, 2))
    deviation = np.sqrt(np.maximum(variance, 1e-12))
    d = np.log(power / cost) / deviation + deviation / 2
    value = 110 * np.sum(power * norm.cdf(d) - cost * norm.cdf(d - deviation))
    slope = -220 * np.sum(norm.cdf(d - deviation))
    setup = make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    result = evaluate(problem, rule, paths=16384, engine=engine)
    assert abs(result.value - value) < 2 * result.standard_error
    above = bound(problem, rule, relaxation=EnergyRelaxation(problem), engine=engine, paths=1024)
    assert above.upper.value + 3 * above.upper.standard_error >= value
    assert above.upper.value - above.lower.value < 0.01 * value
    blocks = sensitivities(problem, rule, paths=16384, engine=engine).held["co2_curve"].blocks
    sums = blocks.reshape(len(blocks), -1).sum(axis=1)
    assert abs(sums.mean() - slope) < 2 * sums.std(ddof=1) / len(sums) ** 0.5


@pytest.mark.prove
def test_derivatives_and_a_fixed_price(folder):
    """Eight hours without fuel of starts and idle: without volatility the derivative by the curve
    of certificates is minus the emissions, 1.6 for each MWh; the value is that of a fixed price."""
    changes = {"contract.fuel": {"per_mwh": 1.6}, "contract.starts": [], "contract.min_up": 2}
    changes |= {"contract.min_down": 1}
    case = with_market(folder, 0.0, **changes)
    setup = make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    value = evaluate(problem, rule, paths=4096, engine=engine)
    keys = {name.removeprefix("contract."): x for name, x in changes.items()}
    best = exact(plant(end=END, **keys), finer=1)
    assert abs(value.value - best) < 2 * value.standard_error + 1e-4 * best
    held = sensitivities(problem, rule, paths=4096, engine=engine).held["co2_curve"]
    draws = problem.sources.evaluation.draws(np.arange(4096), problem.simulator)
    totals = engine.bind(problem).values(rule, draws, EXACT).totals
    assert float(np.sum(held.value)) == pytest.approx(-1.6 * np.mean(totals["power"]), rel=1e-5)
    # With a volatility the same program has other numbers.
    moving = bare_problem(with_market(folder, 0.5, **changes))
    problem = problem.at({n: x.value for n, x in moving.inputs_by_name.items()})
    assert wrong_derivatives(problem, rule, paths=16, engine=engine) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"contract.emission": {"market": "co2", "price": 3.0}}, "emission.*one of"),
        ({"contract.emission": {"per_fuel": 1.0}}, "emission.*one of"),
        ({"contract.emission": {"market": "coal"}}, "emission.market"),
        ({"contract.emission": {"price": 14.0}}, "market.co2.*allowed only if"),
        ({"market.co2": None}, "market.co2.*is needed if"),
        ({"model.co2": None}, "model.co2.*is needed if"),
        ({"model.correlation": [["power", "co2", 0.5]] * 2}, "model.correlation.*one entry for each pair"),
        (
            {
                "model.correlation": [
                    ["power", "co2", 0.9], ["gas", "co2", 0.9], ["power", "gas", -0.9],
                ]
            },
            "model.correlation.*positive definite",
        ),
    ],
)  # fmt: skip
def test_mistakes_are_named(changes, words, folder):
    with pytest.raises(CaseError, match=words):
        with_market(folder, 0.5, **changes)
