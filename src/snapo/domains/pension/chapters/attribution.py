"""The funding ratio at the horizon: the parts of its change, and the sources of its variance.

Attribution: the change from today to the horizon in parts that add up to it.

In a step F = A / L changes by dA (1 / L + 1 / L') / 2 - dL (A + A') / (2 L L'). This is exact: it
is the mean of two splits, with the assets moved first and with the liability moved first. dA and dL
are sums of parts:

- assets: contributions; benefits and expenses; costs; interest on the assets at the short rate; and
  the return over cash of bonds with swaps, of credit, and of the classes with a separate shock.
- liability, in this order: benefits paid; rights accrued; interest at the short rate; the
  remainder, which is due to the curve (and to prices, where payments follow them); mortality that
  differs from the expected one; indexation granted beyond the part valued.

Variance: each source of risk is removed in turn. The trained policy decides throughout, on the
same paths; only the volatilities of one source are zero. Shares need not add up to one: sources
offset each other, and the policy reacts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.case.given import CaseInput
from snapo.problem.quickly import compiled_sooner
from snapo.problem.simulator import Schedule
from snapo.report.bands import Swing, tornado
from snapo.report.drawing import draw
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Table, Text
from snapo.solver.evaluate import path_totals
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..fund.books import MINIMUM, balance
from ..fund.simulator import Happened, PensionSimulator
from ..records.case import PensionCase, PensionModel
from ..records.inputs import every_given
from ..results.setup import case_of
from ..run import PensionRun, points, share, with_measure

PATHS = 4096
ROWS = (
    ("interest", "Interest at the short rate"),
    ("rates", "Rates: return of bonds and swaps over cash, and the change of the liability"),
    ("credit", "Credit over cash"),
    ("assets", "Other classes over cash"),
    ("accrual", "Contributions against accrual"),
    ("benefits", "Benefits and expenses"),
    ("indexation", "Indexation"),
    ("mortality", "Mortality"),
    ("costs", "Costs"),
)


@dataclass(frozen=True)
class RatioEffect:
    """The mean effect of a part on the funding ratio: through the `assets`, through the
    `liability`, and in total (`mean`); `deviation` is the standard deviation of the total."""

    part: str = ""
    name: str = ""
    assets: Number = np.nan
    liability: Number = np.nan
    mean: Number = np.nan
    deviation: Number = np.nan


@dataclass(frozen=True)
class RatioChange:
    """The funding ratio at the horizon minus that of today: mean and standard deviation."""

    mean: Number = np.nan
    deviation: Number = np.nan


@dataclass(frozen=True)
class RatioParts:
    """The funding ratio of today (`start`), the parts of its change (`rows`), and the simulated
    `change` to which the parts must add up. There are no rows for a fund without a liability."""

    start: Number = np.nan
    rows: tuple[RatioEffect, ...] = ()
    change: RatioChange = field(default_factory=RatioChange)


def measure(run: StudyRun) -> RatioParts:
    """The mean effect of every part over the first paths of the evaluation."""
    case, setup, policy = case_of(run), run.setup, run.solution.policy
    assert policy is not None
    simulator = Explained.of(case)
    with jax.enable_x64(True):
        schedule = jax.tree.map(np.asarray, _moments(setup.problem.schedule))
    problem = replace(setup.problem, simulator=simulator).prepared(schedule)
    constants = problem.schedule.constants
    assets, liability = float(constants.assets), float(constants.liability)
    if liability <= MINIMUM * assets:
        return RatioParts()
    paths = problem.sources.evaluation.available(min(PATHS, setup.evaluation.paths))
    totals = path_totals(problem, policy, paths, engine=setup.engines.evaluate)
    rows = []
    prices = case.liability.future_indexation != "none"
    for key, name in ROWS:
        if key == "rates" and prices:
            name = name.replace("Rates", "Rates and prices")
        through = [totals.get(f"{key} {side}", np.zeros(paths)) for side in ("assets", "liability")]
        both = through[0] + through[1]
        means = through[0].mean(), through[1].mean(), both.mean()
        rows.append(RatioEffect(key, name, *means, both.std()))
    final = totals["funding_ratio"]
    change = RatioChange(final.mean() - assets / liability, final.std())
    return RatioParts(assets / liability, tuple(rows), change)


class Moment(NamedTuple):
    """A step; and for its end the people and the curve's shape one step later."""

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
        owed = balance(self.model, constants, now.people, now.shape, after).liability
        # As if nothing about mortality had been learned in the step.
        market = after.market._replace(mortality=state.market.mortality)
        expected = after._replace(market=market)
        as_expected = balance(self.model, constants, now.people, now.shape, expected).liability
        gained = _assets(self.model, done)
        added = self._liability(done, owed, as_expected, constants.plan.reserved)
        by_assets = (1 / before + 1 / owed) / 2
        by_liability = -(state.assets + after.assets) / (2 * before * owed)
        outputs = {f"{name} assets": by_assets * part for name, part in gained.items()}
        outputs |= {f"{name} liability": by_liability * part for name, part in added.items()}
        return after, outputs

    def _liability(
        self, done: Happened, owed: Array, as_expected: Array, reserved: Array
    ) -> dict[str, Array]:
        """Parts of the change of the liability, in money; `owed` at the end of the step,
        `as_expected` the same with mortality as it was expected, `reserved` as in `PlanTerms`."""
        # The reserve for a payment's expenses goes with it.
        books, benefit = done.books, reserved * done.flows.benefit
        selected = books.liability + books.accrual
        interest = (selected - benefit if self._in_advance else selected) * jnp.expm1(
            done.move.cash
        )
        unindexed = jnp.exp(-done.after.jump)
        return {
            "benefits": -benefit,
            "accrual": books.accrual,
            "interest": interest,
            "rates": as_expected * unindexed - (selected - benefit + interest),
            "mortality": (owed - as_expected) * unindexed,
            "indexation": owed * (1 - unindexed),
        }

    def terminal(self, constants, state, smooth):
        return {"funding_ratio": super().terminal(constants, state, smooth)["funding_ratio"]}

    def totals(self):
        return {}

    def slack(self, constants, now, state, outputs):
        return {}


def _assets(case: PensionModel, done: Happened) -> dict[str, Array]:
    """Parts of the change of the assets, in money."""
    cash, flows, held = done.move.cash, done.flows, done.held
    working = done.invested - held.cost
    over = working * held.weights * (done.move.gross - jnp.exp(cash))
    part = np.array([class_.part for class_ in case.assets.classes])
    rates = {name: jnp.sum(over * (part == name)) for name in ("rates", "credit", "assets")}
    if held.notional is not None:
        swaps = jnp.sum(held.notional * jnp.exp(cash) * jnp.expm1(done.move.swaps))
        rates["rates"] = rates["rates"] + swaps
    return rates | {
        "accrual": flows.contribution,
        "benefits": -flows.benefit - flows.expenses,
        "costs": -held.cost,
        "interest": working * jnp.expm1(cash),
    }


def show(run: PensionRun, result: RatioParts) -> Sequence[Block]:
    """The parts as bars and in a table."""
    if not result.rows:
        return [why_missing(run, ATTRIBUTION.name)]
    present = [row for row in result.rows if row.assets or row.liability]
    swings = [Swing(row.name, 100 * row.mean, points(row.mean, 2, True)) for row in present]
    alt = "Mean effects on the funding ratio. " + "; ".join(f"{s.name}: {s.text}" for s in swings)
    height = 40 + 22 * len(swings)
    svg = draw("attribution", alt, lambda axes: tornado(axes, swings, "points of F"), height)
    sums = (sum(getattr(x, key) for x in result.rows) for key in ("assets", "liability", "mean"))
    change = result.change
    body = [_cells(x.name, x.assets, x.liability, x.mean, x.deviation) for x in present]
    body.append(_cells("All parts", *sums, np.nan))
    body.append(_cells("Change of F", np.nan, np.nan, change.mean, change.deviation))
    head = [("", ""), ("Through assets", "points"), ("Through liability", "points")]
    head += [("Mean effect", "points"), ("Standard deviation", "points")]
    caption = (
        f"The funding ratio F from {share(result.start)} today to its mean {run.horizon}: means "
        "over paths under the learned policy. The change in every step is split twice, with the "
        "assets moved first and with the liability moved first, and the mean is taken. The "
        "liability's parts come in the order benefits, accrual, interest, rates, mortality, "
        "indexation. Mortality is the effect of deviations from the table, and indexation that "
        "of increases beyond the part that the liability already includes. The parts add up to "
        "the change of F on every path."
    )
    table = Table(head, body, "", 1, strong=frozenset([len(body) - 2, len(body) - 1]))
    return [Chart(svg, caption), table]


def _cells(name: str, *numbers: float) -> tuple[str, ...]:
    """A name, effects with their signs, and a standard deviation; nothing for NaN."""
    signs = (True, True, True, False)
    return name, *("" if np.isnan(x) else points(x, 2, sign) for x, sign in zip(numbers, signs))


TITLE = with_measure("Parts of the change of the funding ratio")
ATTRIBUTION = Chapter("attribution", TITLE, RatioParts, measure, show, key="attribution")


@dataclass(frozen=True)
class SourceVariance:
    """The final funding ratio with all sources of risk, or without one of them: its mean, its
    standard deviation, and the share of the variance that is removed (`explained`)."""

    source: str = ""
    mean: Number = np.nan
    deviation: Number = np.nan
    explained: float | None = None


def sources(case: PensionCase) -> dict[str, list[CaseInput]]:
    """The volatilities of each source of risk that a case has."""
    records = {
        "interest rates": case.rates,
        "inflation and wages": case.inflation,
        "asset prices": case.assets,
        "credit spreads": case.credit,
        "currencies": case.currencies,
        "mortality": case.lee_carter,
    }
    return {
        name: [item for item in every_given(record) if item.group == "volatility"]
        for name, record in records.items()
        if record is not None
    }


def measure_variance(run: StudyRun) -> tuple[SourceVariance, ...]:
    """The ratio with all sources, then without one at a time; none under supplied scenarios."""
    case, setup, policy = case_of(run), run.setup, run.solution.policy
    assert policy is not None
    if case.scenarios is not None:
        return ()
    paths, risks = min(PATHS, setup.evaluation.paths), sources(case)
    # Numbers that the case holds fixed move too: all are inputs, so that one program serves.
    every = {x.name: x.input() for volatilities in risks.values() for x in volatilities}
    problem = replace(setup.problem, inputs=every | setup.problem.inputs)

    def final(zeros: list[CaseInput]) -> np.ndarray:
        moved = problem.at({entry.name: 0 * entry.values for entry in zeros})
        totals = path_totals(moved, policy, paths, engine=setup.engines.evaluate)
        return totals["funding_ratio"]

    base = final([])
    rows = [SourceVariance("All sources", base.mean(), base.std())]
    for name, volatilities in risks.items():
        present = [entry for entry in volatilities if entry.values.any()]
        if present:
            left = final(present)
            explained = 1 - left.var() / base.var()
            rows.append(SourceVariance(f"Without {name}", left.mean(), left.std(), explained))
    return tuple(rows)


def show_variance(run: PensionRun, result: tuple[SourceVariance, ...]) -> Sequence[Block]:
    """A row for each source."""
    if not result:
        return [why_missing(run, VARIANCE.name)]
    body = [
        (row.source, points(row.mean, 1), points(row.deviation, 1), points(row.explained, 0))
        for row in result
    ]
    head = [("", ""), ("Mean F", "%"), ("Standard deviation", "points"), ("Variance removed", "%")]
    caption = (
        f"The funding ratio {run.horizon} on the same paths with the volatilities of one source at "
        "zero and the decisions of the trained policy. Shares need not add up to 100 %, since "
        "sources may offset each other; a source with a negative share offsets others."
    )
    return [Table(head, body, "", 1, strong=frozenset([0])), Text(caption, caveat=True)]


VARIANCE = Chapter(
    "variance by source", with_measure("Sources of the variance"), tuple[SourceVariance, ...],
    measure_variance, show_variance, "Variance", key="variance", anchor="variance",
)  # fmt: skip
