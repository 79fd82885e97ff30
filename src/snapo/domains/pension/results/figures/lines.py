"""The case in a few lines, and its reconciliation with the actuary's figures."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError, counted
from snapo.study.kind import inputs_line

from ...records.case import PensionCase
from ...records.inputs import input_values, pension_inputs
from ...regulation.bases import bases
from ...regulation.position import stand
from .human import Human, human
from .in_words import in_words
from .plausible import remarks
from .reconcile import LiabilityFigures, ReconciledFigure, check, figures
from .status import StatusGroup, groups, pace

MONTHS = 12
WORTH_TELLING = 0.002  # of the liability


def against_months(case: PensionCase, result: LiabilityFigures) -> list[str]:
    """A remark where the value of payments by month differs noticeably from that by year.

    Only for cohorts: cash flows have the times given by the actuary.
    """
    if case.step != 1 or case.members is None or not result.liability:
        return []
    # One decision will do: the liability today does not depend on the horizon.
    held = replace(case, step=1 / MONTHS, steps=MONTHS, plan=replace(case.plan, accruing=False))
    monthly = figures(held, input_values(case)).liability
    change = result.liability / monthly - 1
    if np.abs(change) < WORTH_TELLING:
        return []
    when = "ends" if case.plan.timing == "arrears" else "beginnings"
    return [
        f"with yearly steps benefits are paid at the {when} of years: the liability differs by "
        f"{change:+.1%} from that of monthly steps, which the fund's valuation may use "
        '(step = "month")'
    ]


SCENARIOS = {"P": "P (real-world)", "Q": "Q (risk-neutral)"}
MONEY = ("liability", "liability on payment nodes")
ROUNDING = 1e-12  # relative errors up to this one are printed as 0
SIZES = ((1e9, " billion"), (1e6, " million"), (1e3, " thousand"))


class Examined(NamedTuple):
    """A case before any simulation: its figures, the reconciliation, and remarks for its user."""

    figures: LiabilityFigures
    lines: list[ReconciledFigure]
    human: Human
    remarks: list[str]


@lru_cache(maxsize=1)  # a study asks before anything is written, and again for its first part
def examine(case: PensionCase) -> Examined:
    """Figures, reconciliation and remarks.

    **Raises:** `CaseError` if a figure differs from the actuary's by more than its tolerance.
    """
    inputs = input_values(case)
    result = figures(case, inputs)
    available = reconciled(case, result)
    observed = human(case, inputs, result)
    return Examined(
        result, available, observed, [*remarks(case, observed), *against_months(case, result)]
    )


def lines(case: PensionCase) -> list[str]:
    """Horizon, inputs and figures of a case as lines of text; nothing is trained."""
    inputs = pension_inputs(case)
    result = examine(case)
    return [
        f"{case.title}: {counted(case.steps, 'decision')} over "
        f"{counted(case.steps * case.step, 'year')}, "
        f"{counted(len(case.assets.classes), 'class')}, {case.buckets} swap "
        f"tenor{'s' * (case.buckets != 1)}",
        f"scenarios: {'supplied' if case.scenarios else SCENARIOS[case.measure]}",
        f"{inputs_line([entry.value.size for entry in inputs.values()])}; {len(case.held)} held "
        "fixed",
        *_human(case, result.human),
        *_status(case, input_values(case), result.figures.liability),
        *in_words(case),
        *_leverage(case),
        *_regulation(case),
        *_funding(case),
        *_pots(case, result.human),
        *(_line(case, line) for line in result.lines),
        *(f"note: {remark}" for remark in result.remarks),
    ]


def _human(case: PensionCase, result: Human) -> list[str]:
    """The figures by which a user recognises the fund, a line for each kind."""
    size = [
        f"assets {readable(result.assets, case.currency)}",
        f"liability {readable(result.liability, case.currency)}",
    ]
    if result.funding is not None:
        size.append(f"funding ratio {result.funding:.1%}")
    lengths = [
        f"liability {result.duration:.1f} years",
        f"assets {result.asset_duration:.1f} years",
    ]
    if result.hedge_ratio is not None:
        lengths.append(f"hedge ratio {result.hedge_ratio:.0%}")
    if result.inflation_hedge_ratio is not None:
        lengths.append(f"inflation hedge ratio {result.inflation_hedge_ratio:.0%}")
    annual = {tenor: float(np.expm1(item)) for tenor, item in result.rate.items()}
    summary = [", ".join(size), f"duration: {', '.join(lengths)}"]
    summary += [
        f"rates, annual: {_by_tenor(annual)}",
        f"rates, continuous: {_by_tenor(result.rate)}",
    ]
    if result.rate_volatility:
        summary.append(f"volatility of rates, per year: {_by_tenor(result.rate_volatility)}")
    grown = ", ".join(f"{name} {entry:.1%}" for name, entry in result.returns.items())
    summary.append(f"returns per year, without shocks: {grown}")
    return summary


def _status(case: PensionCase, inputs: dict[str, Any], liability: float) -> list[str]:
    """Members by status, the cost of accrual and today's contribution, and payments of today."""

    def money(amount: float) -> str:
        return readable(amount, case.currency)

    def of_payroll(amount: float) -> str:
        return f"{money(amount)}{f', {amount / now.payroll:.1%} of payroll' if now.payroll else ''}"

    text = []
    if members := groups(case, inputs):
        text.append("members: " + "; ".join(_group(group, money) for group in members))
    now = pace(case, inputs, liability)
    cost, earned = f"a year's accrual costs {of_payroll(now.accrual)}; ", ""
    increase = (
        f", increase {now.increase:.2%}: {money(now.raised)} of benefits and "
        f"{money(now.liability_raised)} of liability"
    )
    if case.pots is not None:  # payments follow the pots, and nothing accrues
        cost, earned, increase = "", " as earned", ""
    text.append(f"{cost}today's contribution is {of_payroll(now.contribution)}")
    paid = f"benefits {money(now.benefits)}{earned}, expenses {money(now.expenses)}{increase}"
    return [*text, f"payments today, per year: {paid}"]


def _group(group: StatusGroup, money: Callable[[float], str]) -> str:
    salaries = f", payroll {money(group.payroll)}" if group.payroll else ""
    return (
        f"{group.members:,.10g} {group.name} with pensions of {money(group.pensions)}{salaries},"
        f" liability {money(group.liability)}"
    )


def _leverage(case: PensionCase) -> list[str]:
    """The short positions and the borrowed cash, of today and at most; nothing if no weight may be
    negative."""
    assets = case.assets
    if not assets.short:
        return []
    now, by_name = assets.weight.used(), [class_.name for class_ in assets.classes]
    owed = [f"{by_name[i]} {now[i]:.0%} (down to {assets.low[i]:.0%})"
            for i in range(len(now)) if assets.low[i] < 0]  # fmt: skip
    return [f"holdings of {now[now > 0].sum():.0%} of the assets, short or borrowed: "
            f"{', '.join(owed)}"]  # fmt: skip


def _regulation(case: PensionCase) -> list[str]:
    """The fund before its regulator; nothing if the case names none."""
    if case.regulation is None:
        return []
    result = stand(case, input_values(case))
    return [
        f"required own funds {readable(result.required, case.currency)}: required funding ratio"
        f" {result.required_ratio:.1%}, minimum {result.minimum_ratio:.1%}, policy ratio"
        f" {result.policy_ratio:.1%} (rules from {case.regulation.rules.since})"
    ]


def _funding(case: PensionCase) -> list[str]:
    """The bases of funding side by side; nothing if the case has none."""
    if case.funding is None:
        return []
    result, currency = bases(case, input_values(case)), case.currency
    summary = [
        f"{base.name.lower()} (gilts {base.margin:+.2%}): {readable(base.liability, currency)},"
        f" funded {base.ratio:.1%}"
        for base in result.bases
    ]
    plan = result.recovery
    if plan.deficit:
        message = (
            f"recovery plan: {readable(plan.payment, currency)} a year for "
            f"{counted(plan.years, 'year')}"
        )
        summary.append(f"{message} (deficit {readable(plan.deficit, currency)})")
    return summary


def _pots(case: PensionCase, result: Human) -> list[str]:
    """The division into pots and reserve; nothing if rights are promised."""
    if case.pots is None or result.funding is None:
        return []
    selected = float(case.pots.reserve.used())
    pots, reserve = (readable(s * result.assets, case.currency) for s in (1 - selected, selected))
    return [
        f"personal pots {pots}, pensions {(1 - selected) * result.funding:.1%} of those earned;"
        f" solidarity reserve {reserve}, {selected:.1%} of at most"
        f" {float(case.pots.largest.used()):.0%} (rules from {case.pots.rules.since})"
    ]


def _by_tenor(values: dict[int, float]) -> str:
    return ", ".join(f"{tenor}y {value:.2%}" for tenor, value in values.items())


def readable(amount: float, currency: str) -> str:
    """Money with four digits and its size as text: "EUR 308.3 million"."""
    size, word = next((item for item in SIZES if abs(amount) >= item[0]), (1.0, ""))
    return f"{currency} {amount / size:,.1f}{word}"


def _line(case: PensionCase, line: ReconciledFigure) -> str:
    money = line.name in MONEY

    def text(value: float) -> str:
        return readable(value, case.currency) if money else f"{value:,.6g}"

    if line.given is None:
        return f"{line.name}: {text(line.own)}"
    error = line.error if abs(line.error or 0.0) > ROUNDING else 0.0
    return f"{line.name}: {text(line.own)}, reference {text(line.given)} ({error:+.1e})"


def reconciled(
    case: PensionCase, available: LiabilityFigures | None = None
) -> list[ReconciledFigure]:
    """The lines of the reconciliation; `available`: the figures, if they were computed before.

    **Raises:** `CaseError` if a figure differs from the actuary's by more than its tolerance.
    """
    result = check(case, input_values(case), available)
    for line in result:
        if not line.ok and line.given is not None and case.reconcile is not None:
            tolerance = case.reconcile.tolerance
            message = (
                f"the figure of this model is {line.own:.8g}, with a relative difference of "
                f"{line.error:.3g}; the tolerance is {tolerance:g}"
            )
            raise CaseError(str(case.file), f"reconcile.{line.name}", line.given, message)
    return result
