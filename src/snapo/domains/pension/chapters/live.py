"""A fund on the live page: today's trades, and the outcome in funding ratios."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import counted
from snapo.problem.policies.memory import first_decision
from snapo.problem.policy import Policy
from snapo.problem.simulator import at
from snapo.report.quantity import SPACE, number
from snapo.solver.evaluate import estimate
from snapo.study.study import DisplayedValue, LiveTable, PathTotals, Setup, Today

from ..policies.allocation import limit_unit
from ..results import balance
from ..results.balance import ClassTrade
from ..results.setup import case_in, outcome_measure
from .objective import equivalent, headline_name
from .paths import first_traded

TAIL = 0.05  # of the paths: the worst
SMALL = 0.0005  # of the assets: a smaller trade is none
COLUMNS = (
    ("class", ""), ("", ""), ("now", "%"), ("policy", "%"), ("lower bound", "%"),
    ("upper bound", "%"),
)  # fmt: skip


def today(setup: Setup, policy: Policy) -> Today:
    """Today's trades of a fund of promised rights, from the present weights to the policy's."""
    case, problem = case_in(setup), setup.problem
    schedule = jax.tree.map(jnp.asarray, problem.schedule)
    held, action = _first_decision(problem.simulator, schedule, policy)
    weights, positions = first_traded(case, np.asarray(action, np.float64), np.asarray(held))
    trades = balance.trades(case, weights, positions, limit_unit(case))
    assets, scale = float(case.assets.amount.used()), 1e-6
    unit = f"{case.currency}{SPACE}m"
    large = [x for x in trades.classes if abs(x.trade) > SMALL * assets]
    large.sort(key=lambda x: -abs(x.trade))
    texts = [
        f"{_verb(x, assets)} {unit} {number(abs(x.trade) * scale, 1)} of {x.name}"
        for x in large[:3]
    ]
    facts = [
        ("assets", assets * scale, unit),
        ("bought and sold", 50 * float(sum(abs(x.trade) for x in trades.classes)) / assets, "%"),
        ("cost of the trades", float(sum(x.cost for x in trades.classes)) * scale, unit),
    ]
    rows = [
        (x.name, _verb(x, assets), *(100 * float(w) for w in (x.now, x.target, x.low, x.high)),
         float(x.trade) * scale)
        for x in trades.classes
    ]  # fmt: skip
    columns = (*COLUMNS, ("trade", unit))
    return Today(", ".join(texts) or "keep the present allocation", facts, columns, rows)


@eqx.filter_jit  # the same program at all numbers of the inputs
def _first_decision(simulator: Any, schedule: Any, policy: Policy) -> tuple[Any, Any]:
    """The present weights and the first action."""
    state = simulator.initial(schedule.constants, jnp.zeros(simulator.initial_noise_size))
    observed = simulator.observe(schedule.constants, at(schedule.steps, 0), state)
    return state.weights, first_decision(policy, observed)


def _verb(trade: ClassTrade, assets: float) -> str:
    if abs(trade.trade) <= SMALL * assets:
        return "keep"
    return "buy" if trade.trade > 0 else "sell"


def headline(setup: Setup, value: float) -> DisplayedValue | None:
    """The certain ratio with this utility, in %."""
    certain = equivalent(setup.problem.objective, value)
    name = headline_name(setup.problem.objective)
    return certain and DisplayedValue(name, "%", 100 * certain.ratio, 100 * certain.slope)


def outcome(paths: PathTotals) -> list[LiveTable]:
    """The final ratio of a fund: certainty equivalent, mean, tail, probability of a shortfall."""
    case, problem = case_in(paths.setup), paths.setup.problem
    measure = outcome_measure(case)
    ratios = np.asarray(paths.totals[measure.output], np.float64)
    worst = ratios <= np.quantile(ratios, TAIL)
    rows = [
        (f"{measure.mean}, %", *(100 * x for x in paths.mean(ratios))),
        (f"{measure.tail}, %", 100 * float(ratios[worst].mean()), None),
        (f"{measure.below}, %", *(100 * x for x in paths.mean(ratios < 1))),
    ]
    worth = estimate(problem.objective, paths.totals, problem.sources.evaluation,
                     problem.simulator.control_variates())  # fmt: skip
    if certain := equivalent(problem.objective, worth.value):
        error = 100 * certain.slope * worth.standard_error
        rows.insert(0, ("Certainty equivalent of the value, %", 100 * certain.ratio, error))
    columns = (("", ""), ("at the end", ""), ("±", ""))
    text = f"Ratios at the end, after {counted(case.steps * case.step, 'year')}."
    return [LiveTable("Outcome", columns, rows, text)]
