"""The simulated contract: what can be reached, prices, limits kept, and values known exactly."""

import datetime
import shutil
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.domains.gas_storage.references import reference_schedules as references
from tests.domains.gas_storage.storage_cases import (
    CASES,
    bare,
    changed,
    random_actions,
    read,
    untrained,
)

from snapo.domains.gas_storage.contract.reachable import reachable
from snapo.domains.gas_storage.contract.schedule import StoreState, of_prices
from snapo.domains.gas_storage.contract.terms import (
    end_interval,
    inventory_limits,
    known_schedule,
    value_without_decisions,
)
from snapo.domains.gas_storage.prices.process import in_numpy
from snapo.domains.gas_storage.references.intrinsic import intrinsic
from snapo.engine import Xla
from snapo.engine.native import Native
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem, prepare
from snapo.problem.record.either import with_numpy
from snapo.problem.scenarios import Pseudo, Sources
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact
from snapo.solver.adjoint import pull_back, value_and_gradient

DAYS = 8


# Against schedules built independently, by hand.


@pytest.mark.parametrize(
    ("name", "builder"),
    [
        ("G1", references.flagship),
        ("G3", references.dated_ratchets),
        ("G6", references.slow_storage),
    ],
)
def test_schedule_of_a_case(name, builder):
    simulator, _, schedule = bare(read(name))
    expected, factors = builder().steps, builder().factors
    for field in ("forward", "gas_discount", "flow_discount", "injection_cost_discount", "low"):
        assert_allclose(
            getattr(schedule.steps, field), getattr(expected, field), atol=1e-9, rtol=1e-12
        )
    for field in ("high", "next_low", "next_high"):
        found, wanted = getattr(schedule.steps, field), getattr(expected, field)
        assert_allclose(found, wanted, atol=1e-7, rtol=1e-9)
    own = simulator.process.factors(of_prices(schedule))
    for field in ("variance", "loading", "shock", "decay"):
        assert_allclose(getattr(own, field), getattr(factors, field), atol=1e-7, rtol=1e-9)
    plan = intrinsic(schedule, "linear").inventory
    assert np.all(plan[:-1] >= schedule.steps.low - 1e-6)
    assert np.all(plan[:-1] <= schedule.steps.high + 1e-6)


# Random contracts: one compiled simulator, whatever the numbers.


@pytest.fixture(scope="module", params=["linear", "step"])
def template(request, tmp_path_factory):
    """A contract whose every number is given day by day, for the numbers to be replaced."""
    folder = tmp_path_factory.mktemp(request.param)
    first = datetime.date(2025, 1, 1)
    dates = [(first + datetime.timedelta(n)).isoformat() for n in range(DAYS + 1)]
    keys = {}
    for key, value in {"max_inventory": 60, "min_inventory": 0, "min_injection": 0}.items():
        rows = "\n".join(f"{date},{value}" for date in dates)
        (folder / f"{key}.csv").write_text(f"date,value\n{rows}\n")
        keys[key] = f'{key} = "{key}.csv"'
    (folder / "min_withdrawal.csv").write_text((folder / "min_injection.csv").read_text())
    blocks = "".join(f"{date},0,5,5\n,20,6,5\n,60,7,4\n" for date in dates[:-1])
    (folder / "ratchets.csv").write_text(f"date,inventory,max_withdrawal,max_injection\n{blocks}")
    (folder / "curve.csv").write_text("date,price\n2025-01,20.0\n")
    (folder / "case.toml").write_text(
        f"""kind = "gas-storage"
title = "template"
[contract]
start = 2025-01-01
end = {dates[-1]}
inventory = 20.0
{chr(10).join(keys.values())}
min_withdrawal = "min_withdrawal.csv"
ratchets = "ratchets.csv"
ratchet_interpolation = "{request.param}"
end_inventory = 20.0
[market]
valuation_date = 2025-01-01
forward_curve = "curve.csv"
[model]
kind = "one-factor"
mean_reversion = 20.0
volatility = 0.5
"""
    )
    return bare(changed(folder))


def contract_numbers(random, inputs) -> dict[str, np.ndarray]:
    """Numbers of a random contract, often a tight or an impossible one."""
    days = DAYS + 1
    high, low = random.uniform(30, 60, days), random.uniform(0, 15, days)
    forced = np.where(random.uniform(size=(2, days)) < 0.15, random.uniform(0, 4, (2, days)), 0.0)
    forced[1, forced[0] > 0] = 0.0
    numbers = {
        "max_inventory": high if random.uniform() < 0.5 else np.full(days, 50.0),
        "min_inventory": low if random.uniform() < 0.5 else np.zeros(days),
        "min_injection": forced[0],
        "min_withdrawal": forced[1],
        "inventory_loss": random.choice([0.0, 0.01, 0.05], 1),
        "end_inventory": random.uniform(0, 50, 1),
    }
    rows = np.sort(random.uniform(0, 60, (DAYS, 3)), axis=1)
    rows[:, 0] = 0.0
    numbers["ratchet_inventory"] = rows
    shape = rows.shape
    numbers["ratchet_withdrawal"] = random.choice([0.0, 1.0, 1.0], shape) * random.uniform(
        0, 15, shape
    )
    numbers["ratchet_injection"] = random.choice([0.0, 1.0, 1.0], shape) * random.uniform(
        0, 15, shape
    )
    return {
        name: np.resize(value, inputs[name].value.shape)
        for name, value in numbers.items()
        if name in inputs
    }


def with_numbers(template, seed):
    simulator, inputs, _ = template
    new = dict(inputs)
    for name, value in contract_numbers(np.random.default_rng(seed), inputs).items():
        new[name] = eqx.tree_at(lambda i: i.value, new[name], value)
    return simulator, new, prepare(simulator, new)


def flows_of_a_day(steps, t, inventory, kind):
    """Least and most net flow by rates and forced flows alone, [n]; least > most: none."""
    levels = steps.levels[t]
    if kind == "linear":
        out = np.interp(inventory, levels, steps.withdrawal_rate[t])
        into = np.interp(inventory, levels, steps.injection_rate[t])
    else:
        row = np.maximum(np.searchsorted(levels, inventory, side="right") - 1, 0)
        out, into = steps.withdrawal_rate[t][row], steps.injection_rate[t][row]
    least = np.where(steps.min_injection[t] > 0, steps.min_injection[t], -out)
    most = np.where(steps.min_withdrawal[t] > 0, -steps.min_withdrawal[t], into)
    # An inventory on the edge may miss its forced flow by rounding.
    spare = 1e-7
    impossible = (into < steps.min_injection[t] - spare) | (out < steps.min_withdrawal[t] - spare)
    return np.where(impossible, np.inf, least), np.where(impossible, -np.inf, most)


@pytest.mark.parametrize("name", ["quick", "G4", "G5"])
def test_the_schedule_of_known_prices_is_that_of_the_simulator(name):
    """In NumPy and compiled, to rounding; forced flows, dated costs and fuel, worth at the end."""
    case = read(name)
    known, schedule = known_schedule(case), bare(case)[2]
    for part, other in ((known.steps, schedule.steps), (known.constants, schedule.constants)):
        names = [key for key, x in part._asdict().items() if isinstance(x, np.ndarray | float)]
        assert len(names) > 7
        for key in set(names) - {"hedge"}:
            numbers = getattr(part, key)
            assert_allclose(numbers, getattr(other, key), rtol=1e-12, atol=1e-9, err_msg=key)


@pytest.mark.prove
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 10**6))
def test_reachable_is_the_longest_interval_that_can_go_on(template, seed):
    simulator, inputs, schedule = with_numbers(template, seed)
    steps, kind = schedule.steps, simulator.interpolation
    numbers = {name: entry.value for name, entry in inputs.items()}
    at_inputs = partial(in_numpy, numbers)
    limits = inventory_limits(simulator.contract, at_inputs)
    in_numpy_too = with_numpy(reachable)(limits, *end_interval(simulator.contract, at_inputs), kind)
    low, high = (x[:-1] for x in in_numpy_too)
    if np.all(np.abs(high - low) > 1e-6):  # a set of one point is there or not by rounding
        assert_allclose(low, steps.low, rtol=1e-12, atol=1e-9)
        assert_allclose(high, steps.high, rtol=1e-12, atol=1e-9)
    for t in reversed(range(DAYS)):
        if steps.next_low[t] > steps.next_high[t]:
            assert steps.low[t] > steps.high[t]
            continue
        low, high = float(limits.minimum[t]), float(limits.maximum[t])
        # What cannot go on may begin or end at a row, and be narrower than a regular grid.
        rows = steps.levels[t]
        rows = np.concatenate([rows, rows - 1e-7, (rows[1:] + rows[:-1]) / 2])
        grid, cell = np.linspace(low, high, 4001, retstep=True)
        grid = np.union1d(grid, rows[(rows > low) & (rows < high)])
        least, most = flows_of_a_day(steps, t, grid, kind)
        keep = grid * (1 - steps.inventory_loss[t])
        good = np.maximum(keep + least, steps.next_low[t]) <= np.minimum(
            keep + most, steps.next_high[t]
        )
        runs = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]]))).reshape(-1, 2)
        longest = max((grid[b - 1] - grid[a] for a, b in runs), default=-1.0)
        length = max(steps.high[t] - steps.low[t], -1.0)
        # What lies between two points of the grid may be missed, on either side.
        assert length >= longest - 1e-9
        inside = (grid > steps.low[t] + 1e-6) & (grid < steps.high[t] - 1e-6)
        assert good[inside].all()
        assert length <= max(longest, 0) + 2 * cell + 1e-9


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 10**6))
def test_any_decisions_keep_every_limit(template, seed):
    simulator, _, schedule = with_numbers(template, seed)
    steps, paths = schedule.steps, 64
    if np.any(steps.low > steps.high):
        return
    random = np.random.default_rng(seed)
    inventory = random.uniform(steps.low[0], steps.high[0], paths)
    inventory[:2] = steps.low[0], steps.high[0]
    actions = random_actions(DAYS, paths, seed)
    moved = rollout(simulator, schedule, inventory, actions)
    kind = simulator.interpolation
    for t in range(DAYS):
        before, after, injection, withdrawal = (np.asarray(x) for x in moved[t])
        assert np.all(injection >= 0) and np.all(withdrawal >= 0)
        assert_allclose(
            after, before * (1 - steps.inventory_loss[t]) + injection - withdrawal, atol=1e-9
        )
        assert np.all(after >= steps.next_low[t] - 1e-7)
        assert np.all(after <= steps.next_high[t] + 1e-7)
        if kind == "step":
            # At a row of step ratchets, rounding decides which row holds.
            clear = np.abs(before[:, None] - steps.levels[t]).min(1) > 1e-6
        else:
            clear = np.full(paths, True)
        least, most = flows_of_a_day(steps, t, before, kind)
        net = injection - withdrawal
        assert np.all(net[clear] >= least[clear] - 1e-6)
        assert np.all(net[clear] <= most[clear] + 1e-6)


def rollout(simulator, schedule, inventory, actions):
    """[(before, after, injection, withdrawal)] day by day; compiled once per simulator."""
    found = []
    with jax.enable_x64(True):
        for t in range(DAYS):
            day = jax.tree.map(jnp.asarray, at(schedule.steps, t))
            constants = jax.tree.map(jnp.asarray, schedule.constants)
            after, out = _one_day(simulator, constants, day, jnp.asarray(inventory), actions[t])
            found.append((inventory, after.inventory, out["injection"], out["withdrawal"]))
            inventory = after.inventory
    return found


@eqx.filter_jit
def _one_day(simulator, constants, now, inventory, actions):
    def step(inventory, action):
        state = StoreState(inventory, jnp.zeros(1))
        return simulator.step(constants, now, state, action, jnp.zeros(1), Exact())

    return jax.vmap(step)(inventory, actions)


# Prices.


def spots(case, paths, seed=3):
    """Spot prices [T, paths] and factors [T, paths, F] of simulated paths."""
    simulator, _, schedule = bare(case)
    draws = Pseudo(seed).draws(np.arange(paths), simulator)
    nothing = np.zeros((simulator.horizon, paths, 2))
    rolled = Xla("float64").values(
        simulator, None, schedule, draws, Exact(), actions=nothing, record=("state",)
    )
    factors = np.asarray(rolled.record["state"].price)
    steps = schedule.steps
    log = np.einsum("tnf,tf->tn", factors, steps.price.loading) - steps.price.variance[:, None] / 2
    return schedule, steps.forward[:, None] * np.exp(log), factors


@pytest.mark.prove
def test_prices_of_correlated_factors():
    """Mean, variance and correlation of a factor that reverts and one that does not."""
    model = {
        "kind": "multi-factor",
        "mean_reversion": None,
        "volatility": None,
        "factors": [
            {"mean_reversion": 0.0, "volatility": 0.3},
            {"mean_reversion": 30.0, "volatility": 0.9},
        ],
        "correlation": [[1.0, -0.4], [-0.4, 1.0]],
    }
    case = read("quick", market={"valuation_date": datetime.date(2024, 12, 12)}, model=model)
    paths = 65536
    schedule, prices, factors = spots(case, paths)
    error = prices.std(1) / np.sqrt(paths)
    assert np.all(np.abs(prices.mean(1) - schedule.steps.forward) < 4.5 * error)
    time = schedule.steps.day / 365
    assert time[0] == 20 / 365
    covariance = -0.4 * -np.expm1(-30 * time) / 30
    own = -np.expm1(-60 * time) / 60
    expected = 0.09 * time + 0.81 * own + 2 * 0.27 * covariance
    assert_allclose(schedule.steps.price.variance, expected, rtol=1e-12)
    # The sample variance of normals has a relative error of sqrt(2 / paths) = 0.0055.
    assert_allclose(np.log(prices).var(1), expected, rtol=0.025)
    sample = np.einsum("tn,tn->t", factors[..., 0], factors[..., 1]) / paths
    spread = np.sqrt(time * own / paths) * 4.5
    assert np.all(np.abs(sample - covariance) < spread)


def test_prices_of_the_slow_storage_follow_the_published_recursion():
    """x(t + 1) = 0.88 x(t) + eps / sqrt(365), S = F exp(x - variance / 2), S = F on day 0."""
    schedule, prices, factors = spots(read("G6"), 4)
    volatility = 1.0645537
    assert_allclose(schedule.steps.price.next_decay, 0.88, rtol=1e-7)
    assert_allclose(volatility * schedule.steps.price.next_shock[:, 0, 0], 365**-0.5, rtol=1e-7)
    assert_allclose(prices[0], schedule.steps.forward[0], rtol=0)
    assert not factors[0].any()
    variance = (1 - 0.88 ** (2 * np.arange(365))) / (1 - 0.88**2) / 365
    assert_allclose(schedule.steps.price.variance, variance, rtol=1e-6)


# Forced flows: every policy earns the same.


def cash_flow(case, paths, policy=None, seed=4, engine=None):
    simulator, _, schedule = bare(case)
    draws = Pseudo(seed).draws(np.arange(paths), simulator)
    actions = None if policy else random_actions(simulator.horizon, paths, seed)
    if policy:
        policy = untrained(simulator, schedule, policy)
    rolled = (engine or Native("float64")).values(
        simulator, policy, schedule, draws, Exact(), actions=actions
    )
    return np.asarray(rolled.totals["cash_flow"])


@pytest.mark.prove
def test_forced_flows():
    case = read("G5")
    cash = cash_flow(case, 65536, policy=1)
    # Antithetic pairs are the independent draws.
    pairs = cash.reshape(-1, 2).mean(1)
    error = pairs.std(ddof=1) / np.sqrt(pairs.size)
    assert abs(pairs.mean() + 156_115.5176) < 3 * error
    assert_allclose(cash.std(), 51_227, rtol=0.02)
    assert_array_equal(cash, cash_flow(case, 65536, policy=2))
    assert_allclose(cash[:64], cash_flow(case, 64), rtol=1e-12)


def test_forced_flows_without_volatility():
    cash = cash_flow(read("G5", model={"volatility": 0.0}), 2, policy=1)
    assert_allclose(cash, -156_115.5176, rtol=1e-9)


# Identities.


@pytest.mark.prove
@pytest.mark.parametrize(
    ("name", "tables"),
    [
        ("G1", {}),
        pytest.param("G3", {}, marks=pytest.mark.prove),
        pytest.param("G4", {}, marks=pytest.mark.prove),
        pytest.param("G6", {}, marks=pytest.mark.prove),
        ("quick", {"contract": {"end_inventory": "free", "end_value": 0.8}}),
        (
            "quick",
            {
                "contract": {
                    "injection_fuel": 0.02,
                    "withdrawal_fuel": 0.01,
                    "inventory_loss": 0.001,
                    "inventory_cost": 0.01,
                }
            },
        ),
    ],
)
def test_the_curve_explains_the_value_before_costs(name, tables):
    """Sum of F x delta = value + present value of costs, for a policy that was never trained."""
    simulator, inputs, schedule = bare(read(name, **tables))
    policy, engine, paths = untrained(simulator, schedule), Native("float64"), 256
    sources = Sources.of(Pseudo(1))
    problem = Problem(simulator, inputs, Mean("cash_flow"), sources)
    given = {"paths": paths, "engine": engine}
    value, gradient = value_and_gradient(problem, policy, decisions="held", **given)
    draws = Pseudo(1).draws(np.arange(paths), simulator)
    costs = np.asarray(engine.values(simulator, policy, schedule, draws, Exact()).totals["costs"])
    explained = np.sum(inputs["forward_curve"].value * gradient.inputs["forward_curve"])
    assert_allclose(explained, value + costs.mean(), rtol=1e-9)


def test_one_factor_without_reversion_is_worth_its_intrinsic_value():
    case = read("quick", model={"mean_reversion": 0.0, "volatility": 0.6})
    _, _, schedule = bare(case)
    plan = intrinsic(schedule, "linear").value
    cash = cash_flow(case, 16384, policy=1).reshape(-1, 2).mean(1)
    assert cash.mean() <= plan + 3 * cash.std() / np.sqrt(cash.size)


# Supplied prices, ends, and dates.


@pytest.mark.prove
@pytest.mark.parametrize("rescaled", [True, False])
def test_supplied_paths(tmp_path, rescaled):
    folder = tmp_path / "case"
    shutil.copytree(CASES / "quick", folder)
    random = np.random.default_rng(0)
    files = {}
    for key in ("training_paths", "evaluation_paths"):
        files[key] = f"{key}.npy"
        np.save(folder / files[key], random.uniform(15, 30, (40, 30)))
    model = {"kind": "supplied", "mean_reversion": None, "volatility": None, **files}
    case = changed(folder, model=model | {"rescale_to_curve": rescaled})
    simulator, inputs, schedule = bare(case)
    source = case.model.sources(0).evaluation
    draws, engine = source.draws(np.arange(40), simulator), Native("float64")
    actions = random_actions(30, 40)
    rolled = engine.values(
        simulator, None, schedule, draws, Exact(), actions=actions, record=("outputs",)
    )
    out = {name: np.asarray(x) for name, x in rolled.record["outputs"].items()}
    raw = np.load(folder / "evaluation_paths.npy")
    prices = raw.T
    if rescaled:
        prices = schedule.steps.forward[:, None] * (raw / raw.mean(0)).T
        assert_allclose(prices.mean(1), schedule.steps.forward, rtol=1e-12)
    cost, discount = 0.05, schedule.steps.gas_discount[:, None]
    earned = (out["withdrawal"] - out["injection"]) * prices
    earned = earned - cost * (out["withdrawal"] + out["injection"])
    assert_allclose(rolled.totals["cash_flow"], (earned * discount).sum(0), rtol=1e-9)
    passed = engine.adjoint(
        simulator,
        None,
        schedule,
        draws,
        Exact(),
        {"cash_flow": np.full(40, 1 / 40)},
        actions=actions,
        wrt=("schedule",),
    )
    delta = pull_back(simulator, inputs, [passed.schedule])["forward_curve"]
    assert bool(np.any(delta)) == rescaled


def test_gas_left_is_worth_what_the_contract_says(tmp_path):
    """Nothing can move: all of the value is the end's."""
    still = {"max_injection": 0.0, "max_withdrawal": 0.0, "end_inventory": "free"}
    case = read("quick", contract=still | {"end_value": 0.8})
    _, _, schedule = bare(case)
    cash = cash_flow(case, 16384)
    terms = schedule.constants
    expected = 10 * 0.8 * terms.end_forward * terms.end_discount
    assert abs(cash.mean() - expected) < 4 * cash.std() / np.sqrt(cash.size)
    folder = tmp_path / "case"
    shutil.copytree(CASES / "quick", folder)
    (folder / "end.csv").write_text("inventory,value\n0,0\n20,400\n50,500\n")
    case = changed(folder, contract=still | {"end_value": "end.csv"})
    assert_allclose(cash_flow(case, 2), 200 * np.exp(-0.03 * 30 / 365), rtol=1e-12)


def test_the_next_day_and_the_days_after_the_end():
    case = read("quick", contract={"first_decision": "next-day"})
    assert case.days[0] == datetime.date(2025, 1, 2) and case.day[0] == 1
    simulator, _, schedule = bare(case)
    assert simulator.horizon == 29
    # The price of the first decision day is not known yet.
    assert_allclose(
        schedule.constants.price.first_shock[0, 0] ** 2, -np.expm1(-2 * 20 / 365) / 40, rtol=1e-12
    )
    late = read("quick", market={"valuation_date": datetime.date(2025, 2, 3)})
    assert not late.days and value_without_decisions(late) == 0.0
    on_the_end = read(
        "quick",
        market={"valuation_date": datetime.date(2025, 1, 31)},
        contract={"end_inventory": "free", "end_value": 0.5},
    )
    price = float(on_the_end.market.forward_curve.values[-1])
    assert_allclose(value_without_decisions(on_the_end), 10 * 0.5 * price)
