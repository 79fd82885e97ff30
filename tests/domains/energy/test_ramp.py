"""A plant with a ramp, against integer programs, the plant without one, and lattices."""

import datetime
import shutil

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp
from tests.domains.energy.energy_cases import HOME, case_at, plant
from tests.lanes.in_numpy import in_numpy

import snapo
from snapo.case.error import CaseError
from snapo.domains.energy.contracts.ramp import power_steps
from snapo.domains.energy.core.simulator import EnergySimulator, simulator_of
from snapo.domains.energy.methods.hindsight import EnergyRelaxation
from snapo.domains.energy.methods.intrinsic import intrinsic_value
from snapo.domains.energy.methods.lattice import lattice
from snapo.domains.energy.setup import bare_problem, factors_of, make_setup
from snapo.engine.native import Native
from snapo.solver.bound import bound
from snapo.solver.derivatives.bump import reactions
from snapo.solver.derivatives.verdict import verdicts
from snapo.solver.evaluate import evaluate
from snapo.solver.sensitivity import sensitivities
from snapo.solver.statistics import Estimate
from snapo.solver.verdict.constant import constant_decisions
from snapo.testing.derivatives import wrong_derivatives

HOURS = 20


def integer_program(power, gas, limits, starts, minimum, before, most_starts=99):
    """The best plan at known prices: unit commitment with continuous powers.

    The three-binary formulation of pglib-uc (github.com/power-grid-lib/pglib-uc, MODEL.md), with
    one limit max(min, ramp) of the first and of the last hour on. `limits`: min, max, ramp;
    `minimum`: hours on and off; `before`: (on, hours, power).
    """
    least, most, ramp = limits
    (min_up, min_down), (was_on, hours, level) = minimum, before
    count, kinds, top = len(power), len(starts), min(max(least, ramp), most)
    idle, rate, price, other = 45.0, 1.6, 14.0, 1.5
    fuel = gas + price
    names = ["q", "on", "up", "down", *(f"kind {k}" for k in range(kinds))]
    size = count * len(names)

    def var(name, t):
        row = np.zeros(size)
        if t >= 0:
            row[names.index(name) * count + t] = 1.0
        return row

    def past(name, t):
        """A known number of an hour before the first one."""
        if t >= 0:
            return 0.0
        return {
            "q": level if was_on else 0.0,
            "on": float(was_on),
            "up": float(was_on and t == -hours),
            "down": float(not was_on and t == -hours),
        }[name]

    rows, lows, highs = [], [], []

    def add(parts, low, high):
        """low <= sum of factor x variable <= high."""
        known = sum(x * past(name, t) for x, name, t in parts)
        rows.append(sum(x * var(name, t) for x, name, t in parts))
        lows.append(low - known)
        highs.append(high - known)

    for t in range(count):
        add([(1, "q", t), (-least, "on", t)], 0, np.inf)
        add([(1, "q", t), (-most, "on", t)], -np.inf, 0)
        add([(1, "on", t), (-1, "on", t - 1), (-1, "up", t), (1, "down", t)], 0, 0)
        add([(1, "up", s) for s in range(t - min_up + 1, t + 1)] + [(-1, "on", t)], -np.inf, 0)
        add([(1, "down", s) for s in range(t - min_down + 1, t + 1)] + [(1, "on", t)], -np.inf, 1)
        step = [(1, "q", t), (-1, "q", t - 1)]
        add([*step, (-ramp, "on", t - 1), (-top, "up", t)], -np.inf, 0)
        add([*step, (ramp, "on", t), (top, "down", t)], 0, np.inf)
        add([(1, "up", t), *((-1, f"kind {k}", t) for k in range(kinds))], 0, 0)
        for k in range(kinds - 1):
            window = range(starts[k][0], starts[k + 1][0])
            add([(1, f"kind {k}", t), *((-1, "down", t - i) for i in window)], -np.inf, 0)
    add([(1, "up", t) for t in range(count)], 0, most_starts)
    cost = np.zeros((len(names), count))
    cost[0] = power - rate * fuel - other
    cost[1] = -idle * fuel
    for k, (_, money, burnt) in enumerate(starts):
        cost[4 + k] = -money - burnt * fuel
    whole = np.repeat(np.arange(len(names)) > 0, count).astype(int)
    high = np.repeat([most, *np.ones(len(names) - 1)], count)
    result = milp(
        -cost.ravel(),
        integrality=whole,
        bounds=Bounds(np.zeros(size), high),
        constraints=LinearConstraint(np.array(rows), lows, highs),
        options={"mip_rel_gap": 0.0},
    )
    assert result.success
    plan = result.x.reshape(len(names), count)
    return -result.fun, plan[1] > 0.5, plan[0]


def case_of(folder, power, gas, limits, starts, minimum, before, most_starts=99):
    """The same as a case."""
    rows = [f"2026-01-05T{h:02d}:00,{x!r}" for h, x in enumerate(map(float, power))]
    (folder / "power.csv").write_text("\n".join(["time,price", *rows]))
    rows = [f"2026-01-05T{h:02d}:00,{x!r}" for h, x in enumerate(map(float, gas))]
    (folder / "gas.csv").write_text("\n".join(["time,price", *rows]))
    on, hours, level = before
    changes = {
        "contract.end": datetime.datetime(2026, 1, 5, len(power)),
        "contract.power": dict(zip(("min", "max", "ramp"), limits)),
        "contract.starts": [dict(zip(("off", "money", "fuel"), x)) for x in starts],
        "contract.min_up": minimum[0],
        "contract.min_down": minimum[1],
        "contract.most_starts": most_starts,
        "contract.before": {"on": hours, "power": level} if on else {"off": hours},
    }
    return case_at(folder, changes)


def schedule_of(case, **numbers):
    """The schedule at other numbers of these inputs, in NumPy."""
    inputs = {name: x.value for name, x in case.inputs().items()} | numbers
    return in_numpy(EnergySimulator.bare(case).prepare)(inputs)


def exact(case):
    """The value on a lattice, whose finer grids move it by less than 0.1 %."""
    factors = factors_of(bare_problem(case))
    return lattice(case.contract.layout, schedule_of(case), factors).value


def at_forward_prices(case):
    return intrinsic_value(case.contract.layout, schedule_of(case))


def random_plant(seed):
    """Prices of some hours and the terms of a plant."""
    rng = np.random.default_rng(seed)
    swing = np.sin(np.arange(HOURS) * rng.uniform(0.4, 0.9))
    power = np.maximum(95 + 60 * swing + rng.normal(0, 25, HOURS), 1.0)
    gas = rng.uniform(20, 28, HOURS)
    least, ramp = (float(np.round(rng.uniform(*x), 1)) for x in ((15, 60), (12, 70)))
    hours = int(rng.integers(1, 4))
    starts = [(hours, 300.0, 5.0), (hours + 4, 1500.0, 20.0)]
    before = (True, int(rng.integers(1, 5)), 77.3) if seed % 2 else (False, 6, 0.0)
    limits = least, 110.0, ramp
    return power, gas, limits, starts, (int(rng.integers(2, 5)), hours), before


@pytest.mark.parametrize("seed", [4])
def test_an_integer_program(seed, tmp_path):
    """Twenty hours at forward prices, where ramp, hours on and off, and starts bind."""
    folder, numbers = (
        shutil.copytree(HOME / "template_plant", tmp_path / "case"),
        random_plant(seed),
    )
    best, on, powers = integer_program(*numbers)
    ramp, changes = numbers[2][2], np.abs(np.diff(powers))
    assert np.any(np.isclose(changes, ramp)) and not on.all() and on.any()
    value = at_forward_prices(case_of(folder, *numbers))
    assert value == pytest.approx(best, abs=1e-6, rel=1e-9)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("seed", "most_starts"), [(0, 99), (1, 99), (2, 99), (3, 99), (5, 99), (6, 99), (4, 1), (1, 1)]
)
def test_random_integer_programs(seed, most_starts, tmp_path):
    folder, numbers = (
        shutil.copytree(HOME / "template_plant", tmp_path / "case"),
        random_plant(seed),
    )
    best, *_ = integer_program(*numbers, most_starts)
    value = at_forward_prices(case_of(folder, *numbers, most_starts))
    assert value == pytest.approx(best, abs=1e-6, rel=1e-9)
    free, *_ = integer_program(*numbers[:2], (*numbers[2][:2], 110.0), *numbers[3:])
    assert value < free - 1.0


def ramped(ramp=25.0, **changes):
    """The template's plant with this ramp."""
    return plant(power={"min": 50.0, "max": 110.0, "ramp": ramp}, **changes)


def test_a_ramp_that_never_binds_changes_nothing():
    """The numbers of the program have the same bits."""
    end = datetime.datetime(2026, 1, 6)
    case, other = ramped(110.0, end=end), plant(end=end)
    assert case.contract.layout == other.contract.layout
    steps, others = (schedule_of(x).steps.terms for x in (case, other))
    for name, numbers in others._asdict().items():
        assert np.array_equal(numbers, getattr(steps, name)), name


@pytest.mark.prove
def test_a_larger_ramp_is_worth_more():
    """Half a day: the values of ramps rise to that without one."""
    end = datetime.datetime(2026, 1, 5, 12)
    values = [exact(ramped(x, end=end)) for x in (11, 59, 61, 109.9)]
    free = exact(plant(end=end))
    assert np.all(np.diff(values) > 0) and values[-1] == pytest.approx(free, rel=2e-3)
    assert values[-1] < free


def test_names_of_powers():
    steps = power_steps(50.0, 110.0, 25.0, None)
    assert [step.name for step in steps.steps] == [
        "min", "max - 2 ramp", "min + 1 ramp", "max - 1 ramp", "min + 2 ramp", "max",
    ]  # fmt: skip
    assert steps.at_ends == (True, False, False, False, False, False)
    below = power_steps(20.0, 110.0, 50.0, 75.0)
    assert [step.name for step in below.steps] == [
        "min", "before - 1 ramp", "1 ramp", "max - 1 ramp", "min + 1 ramp", "before", "2 ramp",
        "max",
    ]  # fmt: skip
    assert below.at_ends == (True, True, True, *(False,) * 5)
    assert below.steps[below.of_before].name == "before"


def test_a_case_begins_in_any_state():
    """The keys of a state lead to a case that begins there, with the same modes."""
    contract = ramped().contract
    for mode in ("on 1, min", "on 3, max - 1 ramp", "on 6, min + 2 ramp", "on 6, max", "off 4"):
        other = ramped(**contract.keys_at({}, mode, None)).contract.layout
        assert other.modes[0] == mode and set(other.modes) == set(contract.layout.modes)
        assert len(other.moves) == len(contract.layout.moves)


def test_other_steps_are_not_known():
    """At ramp = max - min a move by 1 % changes the powers; one of finite differences does not."""
    for ramp, known in ((60.0, False), (25.0, True), (110.0, False), (120.0, True)):
        case = ramped(ramp, end=datetime.datetime(2026, 1, 6))
        for move, fine in ((1e-5, True), (0.01, known)):
            schedule = schedule_of(case, ramp=np.array([ramp * (1 - move)]))
            assert np.isfinite(schedule.steps.terms.fixed).all() == fine


@pytest.mark.prove
def test_policy_bound_and_derivatives():
    """A day: the fitted rule at most 0.5 % below the exact value, the bound at most 1 % above; by
    the ramp the held derivative is that of the lattice."""
    end = datetime.datetime(2026, 1, 6)
    case = ramped(end=end)
    setup = make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    best = exact(case)
    value = evaluate(problem, rule, paths=16384, engine=engine)
    assert abs(value.value - best) < 3 * value.standard_error + 0.005 * best
    result = bound(problem, rule, relaxation=EnergyRelaxation(problem), engine=engine, paths=512)
    assert 0 < result.upper.value - result.lower.value < 0.01 * best
    assert result.upper.value + 3 * result.upper.standard_error >= best
    held = sensitivities(problem, rule, paths=8192, engine=engine).held["ramp"]
    low, high = (exact(ramped(25.0 + x, end=end)) for x in (-0.1, 0.1))
    slope, error = (high - low) / 0.2, float(np.max(held.standard_error))
    assert abs(float(np.sum(held.value)) - slope) < 3 * error + 0.01 * abs(slope)


def test_live_page():
    """Other numbers with the same steps are the same program, as a move on the page needs."""
    forms = [bare_problem(ramped(ramp)).form for ramp in (25.0, 26.0, 60.0)]
    assert forms[0] == forms[1] != forms[2]


EIGHT = {"end": datetime.datetime(2026, 1, 5, 8), "min_up": 1, "min_down": 1}
EIGHT |= {"starts": [{"off": 1, "money": 250.0, "fuel": 6.0}]}


@pytest.mark.prove
def test_every_derivative_is_that_of_differences():
    """Eight hours with a limit of starts, with decisions held fixed."""
    case = ramped(**EIGHT, before={"on": 2, "power": 70.0}, most_starts=2)
    setup = make_setup(case, Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    assert "power_before" in problem.inputs_by_name and case.contract.layout.levels
    assert wrong_derivatives(problem, rule, paths=16, engine=engine) == []


@pytest.mark.prove
def test_a_derivative_at_a_kink_is_not_known():
    """With ramp = max - min, the derivatives by both of them; that by idle fuel is known."""
    setup = make_setup(ramped(60.0, **EIGHT), Native())
    problem, rule, engine = setup.problem, setup.policy.value_rule, setup.engines.evaluate
    inputs = problem.inputs_by_name
    held = {name: Estimate(np.zeros((8, *x.value.shape))) for name, x in inputs.items()}
    table = verdicts(reactions(problem, rule, 64, held, engine=engine))
    unknown = {name for name, row in table.items() if row.source == "not known"}
    assert unknown == {"ramp", "power_min", "power_max"}
    model = snapo.to_onnx(setup.policy, features=problem.features)
    assert model.graph.output[0].name == "action"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"power": {"max": 110.0, "ramp": 0.0}}, "power.ramp.*above 0"),
        ({"power": {"min": 5.0, "max": 400.0, "ramp": 1e-3}}, "power.ramp.*150 states"),
        ({"power": {"min": 5.0, "max": 400.0, "ramp": 3.0}}, "power.ramp.*150 states"),
        ({"before": {"on": 3, "power": 80.0}}, "before.power.*has a ramp"),
        (
            {"power": {"min": 50.0, "max": 110.0, "ramp": 25.0}, "before": {"on": 3}},
            "before.*power",
        ),
        (
            {"power": {"max": 110.0, "ramp": 25.0}, "before": {"on": 3, "power": 111.0}},
            "before.power.*to power.max, 110",
        ),
    ],
)
def test_mistakes_are_named(changes, words):
    with pytest.raises(CaseError, match=words):
        plant(**changes)


def test_an_option_that_is_never_best_is_no_decision_that_never_changes():
    """The weights of the moves of a mode are one decision; the powers themselves are fixed."""
    of = simulator_of(bare_problem(ramped(end=datetime.datetime(2026, 1, 6))))
    layout, groups = of.layout, of.action.together()
    before = [move.before for move in layout.moves]
    several = [mode for mode in range(len(layout.modes)) if before.count(mode) > 1]
    assert layout.fixed_volumes and len(groups) == len(several)
    assert sorted(map(len, groups)) == sorted(before.count(mode) for mode in several)
    # On both paths the first option is best in turns; the others of its mode never are.
    taken = np.zeros((2, 2, of.action.size))
    taken[0][:, groups[0][0]] = taken[1][:, groups[0][1]] = 1.0
    still = constant_decisions(of.action, taken)
    assert [item.number for item in still] == list(range(2, len(groups) + 1))
