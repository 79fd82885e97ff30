"""Notes on a case that is valid but implausible: figures far from those of real funds.

The ranges are wide: a fund outside one of them is possible, and its user knows why.
"""

from collections.abc import Iterator

import numpy as np

from snapo.problem.record.either import with_numpy

from ...fund.contributions import CONTRIBUTIONS
from ...fund.schedule import log_discount
from ...records.case import PensionCase
from ...records.inputs import every_given
from ...records.people import ACTIVE
from .human import Human

FUNDING = (0.4, 2.5)
DURATION = (2.0, 40.0)  # years, of the liability
HEDGE = (-0.25, 1.5)
RATE_VOLATILITY = (0.001, 0.025)  # a year; since 1970 the 10-year rates of G7 countries lie within
RETURN = (-0.03, 0.12)  # geometric, a year
# Groups of numbers on which these figures depend: where a note supposes that one of them is in
# another unit, it is the only note.
PROMISED = {"people", "curve", "plan"}
MARKETS = {"curve", "volatility", "premium", "model", "assets", "credit"}


def remarks(case: PensionCase, human: Human) -> list[str]:
    """A sentence for each figure outside its range, and for a deficit that contributions never
    close."""
    slips = {entry.group for entry in every_given(case) if entry.name in case.slips}
    size = () if slips & PROMISED else _size(case, human)
    market = () if slips & MARKETS else _market(case, human)
    return [*size, *market, *_unpaid(case, human), *_rolling(case, human)]


def _outside(value: float, allowed: tuple[float, float]) -> bool:
    return not allowed[0] <= value <= allowed[1]


def _size(case: PensionCase, human: Human) -> Iterator[str]:
    if human.funding is not None and _outside(human.funding, FUNDING):
        yield (
            f"the funding ratio is {human.funding:.4g}, assets of {human.assets:,.6g} against a "
            f"liability of {human.liability:,.6g} {case.currency}: is fund.assets in the same unit "
            "as the members' pensions?"
        )
    if human.liability and _outside(human.duration, DURATION):
        years = f"below {DURATION[0]:g} or above {DURATION[1]:g}"
        yield (
            f"the duration of the liability is {human.duration:.3g} years, which is rarely {years}"
        )
    if human.hedge_ratio is not None and _outside(human.hedge_ratio, HEDGE):
        yield (
            f"assets and swaps move {human.hedge_ratio:.3g} times as far with rates as the "
            "liability: are the notionals of the swaps in the same unit as fund.assets?"
        )


def _market(case: PensionCase, human: Human) -> Iterator[str]:
    for tenor, volatility in human.rate_volatility.items():
        # With mean reversion the volatility at 30 years may be small.
        low = RATE_VOLATILITY[0] if tenor <= 10 else 0.0
        if _outside(volatility, (low, RATE_VOLATILITY[1])):
            yield (
                f"the volatility of the {tenor}-year rate is {volatility:.2%} a year, which is "
                f"rarely below {low:.1%} or above {RATE_VOLATILITY[1]:.1%}: see rates.volatility "
                "(0.008 is 0.8 % a year) and mean_reversion"
            )
    for name, mean in human.returns.items():
        if _outside(mean, RETURN):
            yield (
                f"{name} grows by {mean:.1%} a year without shocks, which is rarely "
                f"{_percent(RETURN)}: see its mean, return_kind and prices of risk"
            )


def _percent(allowed: tuple[float, float]) -> str:
    return f"below {allowed[0]:.0%} or above {allowed[1]:.0%}"


def _unpaid(case: PensionCase, human: Human) -> Iterator[str]:
    """A deficit that no contribution will ever close."""
    paid = case.plan.contribution
    target = float(paid.target_ratio.used()) if paid.kind == "target" else 1.0
    if case.pots is not None or paid.schedule is not None:  # pots have no deficit
        return
    if human.funding is None or human.funding >= target:
        return
    closed = not _has_salaries(case)
    responds = CONTRIBUTIONS[paid.kind].responds
    if paid.kind == "none":
        reason = 'contributions are of kind "none"'
    elif closed and paid.has_cap:
        reason = "the cap is a share of salaries, but the plan has no salaries"
    elif closed and not responds:
        reason = f'contributions of kind "{paid.kind}" depend on salaries, but there are none'
    else:
        return
    yield (
        f"the funding ratio is {human.funding:.1%}, the target is {target:.0%}, but there are no "
        f"contributions: {reason}. Payments agreed in money go into plan.contribution.schedule, a "
        "limit in money into sponsor_limit"
    )


def _rolling(case: PensionCase, human: Human) -> Iterator[str]:
    """A gap of which every step pays less than the interest."""
    paid = case.plan.contribution
    if paid.kind != "target" or paid.level_steps is not None or human.funding is None:
        return
    target, years = float(paid.target_ratio.used()), float(paid.recovery_years.used())
    if human.funding >= target:
        return
    rate = -float(with_numpy(log_discount)(case, {}, np.array([years]))[0]) / years
    grown, left = np.exp(rate * case.step), case.step / years
    growth = (1 - left) * grown if case.plan.timing == "advance" else grown - left
    if growth >= 1:
        yield (
            f"the gap to a funding ratio of {target:.0%} bears interest of {np.expm1(rate):.1%} a "
            f"year, and recovery_years = {years:g} pays only {1 / years:.1%} of the "
            "remaining gap a year: the gap is never closed. "
            'plan.contribution.recovery = "level" closes it after these years'
        )


def _has_salaries(case: PensionCase) -> bool:
    """Whether anybody earns a salary on which contributions can be paid."""
    if case.members is None:
        return bool(case.cash_flows is not None and case.cash_flows.salary.values.any())
    earning = case.members.status == ACTIVE
    return bool(earning.any() and case.members.salary.used()[earning].any())
