"""The sweep of contributions against the shortfall: points in order, whatever the training."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    EQUITY,
    assets,
    case,
    cash_flows,
    no_contribution,
    plan,
)

from snapo.case.settings import EvaluationTable, TrainingTable
from snapo.domains.pension.chapters import frontier
from snapo.domains.pension.records.case import Frontier
from snapo.domains.pension.results.setup import make_setup
from snapo.problem.objective import CVaR, Mean
from snapo.solver.evaluate import path_totals


def candidate(ratios, paid):
    totals = {"surplus_ratio": np.array(ratios), "pv_contribution": np.array(paid)}
    return frontier.Candidate(None, totals)  # pyright: ignore[reportArgumentType]


def test_each_aim_takes_the_best_of_all_policies():
    """Also one that was trained for another aim; one that is not finite is never taken."""
    safe = candidate([-0.1, -0.1], [3.0, 3.0])
    cheap = candidate([-0.3, -0.2], [1.0, 1.0])
    ruined = candidate([-0.1, np.nan], [0.0, 0.0])
    known, tail = [ruined, safe, cheap], CVaR("surplus_ratio", 0.5)
    assert frontier.best(known, tail) is safe
    assert frontier.best(known, 0.5 * tail - 0.5 * Mean("pv_contribution")) is cheap


def fund():
    """A fund of cash and shares in deficit, which spreads it; the network is untrained."""
    steps = 12
    held = assets(
        steps, [CASH, EQUITY], mean=[0.05], volatility=[0.2], weight=[0.5, 0.5], amount=90.0
    )
    return case(
        steps,
        held_assets=held,
        flows=cash_flows([0.5] * 240, np.arange(240)),
        plan=plan(contribution=no_contribution("spread", spread_factor=0.5)),
        observation=("time", "funding_ratio"),
        training=TrainingTable(steps=0, paths=64, validation_paths=512, learning_rate=0.05),
        evaluation=EvaluationTable(paths=4096, sensitivity_paths=64),
        frontier=Frontier(4, 4, 0.9),
    )


@pytest.mark.study
def test_points_are_in_order_within_their_errors():
    setup = make_setup(fund(), "native")
    totals = path_totals(
        setup.problem, setup.policy, setup.evaluation.paths, engine=setup.engines.evaluate
    )
    run = SimpleNamespace(
        setup=setup,
        solution=SimpleNamespace(policy=setup.policy, totals=totals),
        progress=lambda text: None,
    )
    points = frontier.measure(run).points  # pyright: ignore[reportArgumentType]
    for one, other in pairwise(points):
        paid = np.hypot(one.contributions_error, other.contributions_error)
        tail = np.hypot(one.cvar_error, other.cvar_error)
        assert other.contributions < one.contributions + 2 * paid
        assert other.cvar < one.cvar + 2 * tail
    # Each end serves its own aim best, on fresh paths too.
    assert points[0].cvar > points[-1].cvar
    assert points[0].contributions > points[-1].contributions
