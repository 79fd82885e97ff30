"""Derivatives of twenty stores, drawn at random, beside those of the lattice."""

from dataclasses import replace

import numpy as np
import pytest
from tests.domains.gas_storage.test_corners import ROOM, corners, wave

from snapo.domains.gas_storage.references.lattice import lattice
from snapo.domains.gas_storage.setup import factors, make_setup
from snapo.problem.scenarios import EVALUATE, Pseudo, stream
from snapo.solver.derivatives.verdict import HELD, RANGE
from snapo.solver.evaluate import evaluate, path_totals
from snapo.solver.solve import solve
from snapo.solver.statistics import mean

STORES = 20


def drawn(folder, seed: int):
    """A store of one price factor: rates, costs, what it holds, and how prices move."""
    rng = np.random.default_rng(seed)
    rates = {
        "max_injection": rng.uniform(10, 60), "max_withdrawal": rng.uniform(10, 80),
        "inventory": rng.uniform(0, 0.7) * ROOM,
    }  # fmt: skip
    costs = {f"{name}_cost": rng.uniform(0.02, 0.4) for name in ("injection", "withdrawal")}
    model = {"volatility": rng.uniform(0.3, 1.2), "reversion": rng.uniform(4, 30)}
    return corners(folder, wave, **model, **rates, **costs)


def solved(folder, seed: int, **evaluation):
    setup = make_setup(drawn(folder, seed), "native")
    found = solve(
        setup.problem, setup.policy, training=setup.training,
        evaluation=replace(setup.evaluation, **evaluation), engine=setup.engines,
    )  # fmt: skip
    return setup, found


@pytest.mark.study
def test_right_derivatives_of_stores_are_not_given_away(tmp_path):
    """Held derivatives of a store are right where it has no corner: all runs but one in twenty keep
    every one of them."""
    lost = {}
    for seed in range(STORES):
        table = solved(tmp_path / str(seed), seed)[1].sensitivities
        sources = {name: table.source(name) for name in table.held}
        if refuted := [name for name, source in sources.items() if source not in (HELD, RANGE)]:
            lost[seed] = refuted
    assert len(lost) <= STORES // 20, lost


@pytest.mark.study
@pytest.mark.parametrize("seed", range(10))
def test_no_store_is_reported_with_a_policy_worse_than_the_rule_that_it_began_with(tmp_path, seed):
    """By more than two paired errors, on paths that chose nothing."""
    below = []
    for number in range(16):
        case = drawn(tmp_path / str(number), 100 + number)
        case = replace(case, training=case.training.model_copy(update={"seed": seed}))
        setup = make_setup(case, "native")
        found = solve(
            setup.problem, setup.policy, training=setup.training,
            evaluation=replace(setup.evaluation, sensitivity_paths=0), engine=setup.engines,
        )  # fmt: skip
        fresh = Pseudo(1000 + seed, stream=stream(EVALUATE, 9))
        kept, rule = (
            path_totals(setup.problem, policy, 16384, source=fresh, engine=setup.engines.evaluate)
            for policy in (found.policy, setup.policy)
        )
        change = mean((kept["cash_flow"] - rule["cash_flow"]).reshape(-1, 2).mean(1))
        if change.value < -2 * change.standard_error:
            below.append((number, found.selected, change))
    assert not below, below


@pytest.mark.prove
def test_a_parallel_curve_moves_a_store_as_much_upwards_as_downwards(tmp_path):
    """Within one percent, and the slope within half a percent of the lattice's."""
    setup, found = solved(tmp_path, 3, sensitivity_paths=0)
    problem, engine = setup.problem, setup.engines.evaluate
    curve = problem.inputs_by_name["forward_curve"].value
    moved = [problem.at_values({"forward_curve": curve + shift}) for shift in (0.25, 0.0, -0.25)]
    high, middle, low = (evaluate(x, found.policy, paths=16384, engine=engine).value for x in moved)
    up, down = high - middle, middle - low
    exact = [lattice(x.schedule, factors(x), "linear").value for x in moved]
    assert up == pytest.approx(down, rel=0.01)
    assert (up + down) / 2 == pytest.approx((exact[0] - exact[2]) / 2, rel=0.005)
