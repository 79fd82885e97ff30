"""The change of the funding ratio from today to the horizon, in parts that add up to it.

In a step F = A / L moves by dA (1 / L + 1 / L') / 2 - dL (A + A') / (2 L L'), which is exact: the
mean of moving assets first and of moving the liability first. dA and dL are sums of parts:

- assets: contributions, benefits and expenses, costs; interest of all of them at the short rate;
  and over it, bonds with swaps, credit, and the classes with a shock of their own.
- liability, in this order: benefits paid, rights accrued, both with interest at the short rate;
  the remainder, which is the curve's (and that of prices, where payments follow them);
  mortality away from the expected one; indexation granted beyond the part valued.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.quickly import compiled_sooner
from snapo.problem.simulator import Schedule
from snapo.solver.evaluate import path_totals
from snapo.study.study import StudyRun

from ..fund.books import LEAST, balance
from ..fund.simulator import Happened, PensionSimulator
from ..records.case import PensionCase
from .setup import case_of

PATHS = 4096
ROWS = (
    ("interest", "Interest at the short rate"),
    ("rates", "Rates: bonds and swaps over cash, liability"),
    ("credit", "Credit over cash"),
    ("assets", "Other classes over cash"),
    ("accrual", "Contributions against accrual"),
    ("benefits", "Benefits and expenses"),
    ("indexation", "Indexation"),
    ("mortality", "Mortality"),
    ("costs", "Costs"),
)


def work(run: StudyRun) -> dict[str, Any]:
    """ "attribution": mean effect of every part on the funding ratio, through assets, liability
    and both.

    `rows` hold means over paths and the standard deviation of both together; `change` is the mean
    of F at the horizon less F today by the simulator itself, which the rows must add up to.
    Empty for a fund without a liability.
    """
    case, setup, policy = case_of(run), run.setup, run.solution.policy
    assert policy is not None
    simulator = Explained(case)  # pyright: ignore
    with jax.enable_x64(True):
        schedule = jax.tree.map(np.asarray, _moments(setup.problem.schedule))
    problem = replace(setup.problem, simulator=simulator).prepared(schedule)
    constants = problem.schedule.constants
    assets, liability = float(constants.assets), float(constants.liability)
    if liability <= LEAST * assets:
        return {"attribution": {}}
    paths = problem.sources.evaluation.available(min(PATHS, setup.evaluation.paths))
    totals = path_totals(problem, policy, paths, engine=setup.engines.evaluate)
    rows = []
    prices = case.liability.future_indexation != "none"
    for key, name in ROWS:
        if key == "rates" and prices:
            name = name.replace("Rates", "Rates and prices")
        through = [totals.get(f"{key} {side}", np.zeros(paths)) for side in ("assets", "liability")]
        both = through[0] + through[1]
        row = {"part": key, "name": name, "assets": through[0].mean()}
        row |= {"liability": through[1].mean(), "mean": both.mean(), "deviation": both.std()}
        rows.append(row)
    final = totals["funding_ratio"]
    change = {"mean": final.mean() - assets / liability, "deviation": final.std()}
    return {"attribution": {"start": assets / liability, "rows": rows, "change": change}}


class Moment(NamedTuple):
    """A step and, for its end, people and the curve's shape one step later."""

    period: Any
    people: Any
    shape: Array


def moments(fund: Schedule) -> Schedule:
    """The schedule of `Explained` from that of the fund."""

    def later(rows, last):
        return jnp.concatenate([rows[1:], last[None]])

    terms, steps = fund.constants, fund.steps
    people = jax.tree.map(later, steps.people, terms.last)
    return Schedule(terms, Moment(steps, people, later(steps.shape, terms.last_shape)))


_moments = compiled_sooner(moments)  # not within another program, as `Explained.prepare` is


class Explained(PensionSimulator):
    """The fund with other outputs: the effect of each part of a step on the funding ratio."""

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        return moments(super().prepare(inputs))

    def observe(self, constants, now: Moment, state):
        return super().observe(constants, now.period, state)

    def step(self, constants, now: Moment, state, action, noise, smooth):
        done = self.happen(constants, now.period, state, action, noise, smooth)
        before, after = done.books.liability, done.after
        owed = balance(self.case, constants, now.people, now.shape, after).liability
        # As if nothing about mortality had been learned in the step.
        market = after.market._replace(mortality=state.market.mortality)
        expected = after._replace(market=market)
        as_expected = balance(self.case, constants, now.people, now.shape, expected).liability
        gained = _assets(self.case, done)
        added = self._liability(done, owed, as_expected, constants.plan.reserved)
        by_assets = (1 / before + 1 / owed) / 2
        by_liability = -(state.assets + after.assets) / (2 * before * owed)
        outputs = {f"{name} assets": by_assets * part for name, part in gained.items()}
        outputs |= {f"{name} liability": by_liability * part for name, part in added.items()}
        return after, outputs

    def _liability(
        self, done: Happened, owed: Array, as_expected: Array, reserved: Array
    ) -> dict[str, Array]:
        """Parts of the change of the liability, money; `owed` at the end of the step,
        `as_expected` the same with mortality as it was expected, `reserved` as in `PlanTerms`."""
        # The reserve for a payment's expenses goes with it.
        books, benefit = done.books, reserved * done.flows.benefit
        kept = books.liability + books.accrual
        interest = (kept - benefit if self._in_advance else kept) * jnp.expm1(done.moved.cash)
        unindexed = jnp.exp(-done.after.jump)
        return {
            "benefits": -benefit,
            "accrual": books.accrual,
            "interest": interest,
            "rates": as_expected * unindexed - (kept - benefit + interest),
            "mortality": (owed - as_expected) * unindexed,
            "indexation": owed * (1 - unindexed),
        }

    def terminal(self, constants, state, smooth):
        return {"funding_ratio": super().terminal(constants, state, smooth)["funding_ratio"]}

    def totals(self):
        return {}

    def slack(self, constants, now, state, outputs):
        return {}


def _assets(case: PensionCase, done: Happened) -> dict[str, Array]:
    """Parts of the change of the assets, money."""
    cash, flows, held = done.moved.cash, done.flows, done.held
    working = done.invested - held.cost
    over = working * held.weights * (done.moved.gross - jnp.exp(cash))
    part = np.array([each.part for each in case.assets.classes])
    found = {name: jnp.sum(over * (part == name)) for name in ("rates", "credit", "assets")}
    if held.notional is not None:
        swaps = jnp.sum(held.notional * jnp.exp(cash) * jnp.expm1(done.moved.swaps))
        found["rates"] = found["rates"] + swaps
    return found | {
        "accrual": flows.contribution,
        "benefits": -flows.benefit - flows.expenses,
        "costs": -held.cost,
        "interest": working * jnp.expm1(cash),
    }
