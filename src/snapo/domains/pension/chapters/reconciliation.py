"""The model's figures next to those of the actuary, to check that the fund is the same."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from snapo.case.error import counted
from snapo.report.bands import Layer, stack
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Mark, Table, Text
from snapo.report.quantity import number, percent, power
from snapo.study.chapter import Chapter, Floats, Number, floats
from snapo.study.study import StudyRun

from ..records.case import PensionCase
from ..records.inputs import input_values
from ..regulation.bases import Bases, bases
from ..regulation.position import RecoveryCourse, Stand, stand
from ..results.figures.in_words import in_words
from ..results.figures.lines import examine
from ..results.figures.reconcile import BASIS_POINT, LiabilityFigures, ReconciledFigure
from ..results.setup import case_of
from ..run import PensionRun, share
from .evidence import CONSISTENCY
from .paths import PATHS

RISKS = (
    ("rates", "S1 rates"),
    ("equity", "S2 shares and property"),
    ("currencies", "S3 currencies"),
    ("commodities", "S4 commodities"),
    ("credit", "S5 credit"),
    ("insurance", "S6 insurance"),
    ("active", "S10 active management"),
)
CAVEAT = (
    "The standard model is applied to the present mix, with invested assets equal to the liability"
    " plus the required own funds. Bonds that are not of kind credit bear no spread risk. S6 and "
    "S10 are shares that the case specifies."
)
RECOVERY = (
    "The recovery table compares the policy funding ratio on the paths of the trained policy with "
    "today's required ratio. Contributions, indexation and cuts follow the plan's rules."
)
FUNDING = (
    "Every basis discounts the same expected payments, with the mortality of the case, at annual "
    "rates of the curve plus a margin. The payments of the recovery plan are equal amounts at "
    "the ends of years; their value is the deficit on technical provisions."
)
NAMES = {"liability": "Liability today", "duration": "Duration of the liability"}


@dataclass(frozen=True)
class KeyRateDurations:
    """Years at each node of the curve: minus d ln L / d quote; they add up to the duration."""

    label: tuple[str, ...] = ()
    years: Floats = floats()


@dataclass(frozen=True)
class FundFigures:
    """The figures of a fund before any simulation, as in `LiabilityFigures` and `human.Human`.

    - `lines`: comparisons with the actuary's figures; `remarks`: notes on implausible numbers.
    - `in_words`: the terms of the plan as sentences. `cash_flow`: expected payments by year, in
      money.
    - `regulation`, `funding`: the regulatory position of the fund; None if the case names no rules.
    """

    lines: tuple[ReconciledFigure, ...] = ()
    remarks: tuple[str, ...] = ()
    in_words: tuple[str, ...] = ()
    liability: Number = np.nan
    duration: Number = np.nan
    convexity: Number = np.nan
    inflation01: Number = np.nan
    asset_duration: Number = np.nan
    hedge_ratio: float | None = None
    inflation_hedge_ratio: float | None = None
    rate_volatility: dict[int, Number] = field(default_factory=dict)
    returns: dict[str, Number] = field(default_factory=dict)
    key_rate_durations: KeyRateDurations = field(default_factory=KeyRateDurations)
    cash_flow: Floats = floats()
    regulation: Stand | None = None
    funding: Bases | None = None


@dataclass(frozen=True)
class Reconciliation:
    """The figures; `liability` and `funding` ratio today, the latter None without a liability."""

    reconciliation: FundFigures
    liability: Number = np.nan
    funding: float | None = None


def measure(run: StudyRun) -> Reconciliation:
    """The figures of the case, and those of its regulator."""
    case = case_of(run)
    examined, steps = examine(case), round(1 / case.step)
    local, human = examined.figures, examined.human
    flow = np.asarray(local.cash_flow)
    complete = len(flow) // steps * steps
    inputs = input_values(case)
    result = FundFigures(
        lines=tuple(examined.lines),
        remarks=tuple(examined.remarks),
        in_words=tuple(in_words(case)),
        liability=local.liability,
        duration=local.duration,
        convexity=local.convexity,
        inflation01=local.inflation01,
        asset_duration=human.asset_duration,
        hedge_ratio=human.hedge_ratio,
        inflation_hedge_ratio=human.inflation_hedge_ratio,
        rate_volatility=human.rate_volatility,
        returns=human.returns,
        key_rate_durations=_key_rate_durations(case, local),
        cash_flow=flow[:complete].reshape(-1, steps).sum(1),
        regulation=None if case.regulation is None else stand(case, inputs),
        funding=None if case.funding is None else bases(case, inputs),
    )
    return Reconciliation(result, local.liability, human.funding)


def _key_rate_durations(case: PensionCase, figures: LiabilityFigures) -> KeyRateDurations:
    if not figures.liability:
        return KeyRateDurations()
    years = -figures.key_rate / BASIS_POINT / figures.liability
    return KeyRateDurations(tuple(case.curve.rate.labels), years)


def show(run: PensionRun, result: Reconciliation) -> Sequence[Block]:
    """Figures of the model and of the actuary, and the tests that scenarios must pass."""
    local = result.reconciliation
    blocks: list[Block] = [Text(f"Note: {remark}.", caveat=True) for remark in local.remarks]
    if local.lines:
        head = [("Figure", ""), ("", ""), ("This model", ""), ("Reference", ""), ("Error", "")]
        rows = [_row(line) for line in local.lines]
        blocks.append(Table(head, rows, "Figures of the model, and their references", 2))
    if local.in_words:
        blocks.append(Text(" ".join(f"{_capitalized(text)}." for text in local.in_words)))
    scale, unit = run.size(local.liability)
    hedge = local.inflation_hedge_ratio
    facts = [
        ("Liability", number(local.liability / scale, 2), unit),
        ("Duration", number(local.duration, 2), "years, −d ln L / d parallel shift"),
        ("Convexity", number(local.convexity, 1), "years², for a parallel shift"),
        ("Duration of assets", number(local.asset_duration, 2), "years, with swaps"),
        ("Hedge ratio", percent(local.hedge_ratio, 0), "for a parallel shift"),
    ]
    if hedge is not None:  # a liability without inflation has none
        facts += [
            ("Inflation hedge", percent(hedge, 0), "for a rise of all break-evens"),
            ("Inflation +1 bp", run.large(local.inflation01, 3, True), "change of the liability"),
        ]
    blocks.append(Facts(facts))
    if local.regulation is not None:
        blocks += _regulation(run, local.regulation)
    if local.funding is not None:
        blocks += _funding(run, local.funding)
    if tests := CONSISTENCY.of(run):
        blocks.append(CONSISTENCY.show(run, tests)[0])
    if local.key_rate_durations.label:
        blocks.append(_durations(local.key_rate_durations))
    if local.cash_flow.size:
        blocks.append(_cash_flow(run, local.cash_flow))
    return blocks


def _capitalized(text: str) -> str:
    return text[:1].upper() + text[1:]


def _row(line: ReconciledFigure) -> tuple[Any, ...]:
    name, local = _capitalized(NAMES.get(line.name, line.name)), number(line.own)
    if line.given is None:
        return name, "no reference", local, number(None), ""
    verdict = Mark(bool(line.ok), "holds" if line.ok else "fails")
    return name, verdict, local, number(line.given), power(line.error)


def _durations(result: KeyRateDurations) -> Table:
    """Key-rate durations by node, and their sum."""
    years = np.nan_to_num(result.years)
    rows = [(label, number(x, 3)) for label, x in zip(result.label, years)]
    rows.append(("Sum", number(years.sum(), 3)))
    caption = "Key-rate durations of the liability: −d ln L / d quote at each node of the curve"
    strong = frozenset([len(rows) - 1])
    folded = f"Key-rate durations at {len(years)} nodes"
    return Table([("Node", ""), ("Years", "")], rows, caption, 1, strong=strong, folded=folded)


def _cash_flow(run: PensionRun, flow: np.ndarray) -> Chart | Text:
    paid = np.flatnonzero(flow > flow.max() * 1e-4)
    if not paid.size:
        return Text("No payments are expected.")
    flow = flow[: paid[-1] + 1]
    scale, unit = run.size(flow)
    layer = Layer("Expected payments", flow / scale, "main", 0.75)
    peak = int(np.argmax(flow))
    alt = f"Expected payments by year; they peak at {run.large(flow[peak])} in year {peak + 1}."
    svg = draw(
        "cash-flow", alt, lambda a: stack(a, np.arange(len(flow)), [layer], f"{unit} a year"), 200
    )
    caption = (
        "Expected payments of the rights accrued today, with expected mortality and without future"
        f" indexation: {run.large(flow.sum())} in total, for example "
        + ", ".join(f"year {y} {run.large(flow[y - 1])}" for y in (1, 10, 20) if y <= len(flow))
        + "."
    )
    return Chart(svg, caption)


def _regulation(run: PensionRun, result: Stand) -> list[Block]:
    """Policy ratio, required own funds by risk, and the recovery of the trained policy's paths."""
    policy, required = result.policy_ratio, result.required_ratio
    state = "above the required ratio"
    if policy < required:
        state = "in deficit: a recovery plan is needed"
    if policy < result.minimum_ratio:
        state = "below the minimum"
    facts = [
        ("Policy funding ratio", share(policy), state),
        ("Required funding ratio", share(required), f"own funds {run.large(result.required)}"),
        ("Minimum", share(result.minimum_ratio), f"own funds {run.large(result.minimum)}"),
    ]
    blocks: list[Block] = [Facts(facts), _losses(run, result)]
    caveat = CAVEAT
    if (paths := PATHS.of(run)) and paths.recovery:
        blocks.append(_recovery(paths.recovery))
        caveat = f"{CAVEAT} {RECOVERY}"
    return [*blocks, Text(caveat, caveat=True), _rules(result.since, result.source)]


def _losses(run: PensionRun, result: Stand) -> Table:
    losses = result.losses
    scale, unit = run.size(result.required)
    rows = [(name, number(getattr(losses, key) / scale, 2)) for key, name in RISKS]
    rows.append(("Required own funds", number(result.required / scale, 2)))
    direction = "falling" if losses.falling else "rising"
    caption = f"Losses by risk; for rates the worse scenario is that of {direction} rates"
    strong = frozenset([len(rows) - 1])
    return Table([("Risk", ""), ("Loss", unit)], rows, caption, 1, strong=strong)


def _recovery(result: RecoveryCourse) -> Table:
    rows = [
        (str(year), share(above), share(median))
        for year, above, median in zip(result.years, result.share, result.median)
    ]
    head = [("Year", ""), ("Paths at the required ratio", "%"), ("Median policy ratio", "%")]
    caption = (
        "Recovery: the share of paths whose policy funding ratio is at least the required one;"
        f" a recovery plan may take {counted(result.allowed, 'year')}"
    )
    return Table(head, rows, caption, 1)


def _rules(since: str, source: str) -> Text:
    return Text(f"Rules from {since}: {source}.", caveat=True)


def _funding(run: PensionRun, result: Bases) -> list[Block]:
    """The bases of funding side by side, and the recovery plan."""
    scale, unit = run.size(result.bases[0].liability)
    rows = [
        (
            basis.name,
            percent(basis.margin, 2),
            number(basis.liability / scale, 2),
            number(basis.surplus / scale, 2),
            share(basis.ratio),
            number(basis.duration, 1),
        )
        for basis in result.bases
    ]
    head = [("Basis", ""), ("Over gilts", ""), ("Liability", unit), ("Surplus", unit)]
    head += [("Funding ratio", "%"), ("Duration", "years")]
    table = Table(head, rows, "The bases of funding side by side", 1)
    plan, state = result.recovery, "at" if result.mature else "before"
    facts = [("Maturity", f"{state} significant maturity", "by the duration on low dependency")]
    if plan.deficit:
        when = f"a year for {counted(plan.years, 'year')}, {run.large(plan.total)} in all"
        facts.append(("Recovery plan", run.large(plan.payment), when))
    rules = _rules(result.since, result.source)
    return [table, Facts(facts), Text(FUNDING, caveat=True), rules]


RECONCILIATION = Chapter(
    "reconciliation", "Reconciliation", Reconciliation, measure, show, needs=()
)
