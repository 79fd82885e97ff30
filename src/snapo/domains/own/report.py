"""The report of a run with a user-defined simulator: the sections that every run can have, and
limits."""

from typing import Any

from snapo.report.evidence import history, making
from snapo.report.folder import RunFiles
from snapo.report.page import Mark, Section, Table, Text
from snapo.report.quantity import NONE, SPACE, decimals, finite, measured, number
from snapo.solver.limits import LimitFound
from snapo.study.chapters.bound import value_bounds
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.headline import headline
from snapo.study.chapters.profile import PROFILE
from snapo.study.chapters.sensitivities import sensitivities
from snapo.study.domain import Report

CAVEAT = (
    "A limit is nearly met if the value violates it by less than the half-width of the interval, "
    "or by less than a thousandth of the standard deviation of one path. If the level of a limit "
    "is "
    "raised by one unit, the objective changes by the shadow price. Shadow prices are computed "
    "on fresh paths from derivatives with respect to the policy; a limit with slack has no shadow "
    "price. "
    "Sensitivities are those of the best value within the limits."
)


def limits(run: RunFiles) -> Section:
    """A row for each limit; an empty section, which is not shown, if there are no limits."""
    rows = [_row(LimitFound(**entries)) for entries in run.result.limits]
    head = [
        ("Limit", ""), ("", ""), ("Level", ""), ("Value", ""), ("95 %", ""),
        ("Effect of raising the level by one unit", run.unit), ("", ""),
    ]  # fmt: skip
    caption = "Limits on fresh paths of the exact simulator, with their shadow prices"
    blocks = [Table(head, rows, caption, 2), Text(CAVEAT, caveat=True)] if rows else []
    return Section("limits", "Limits on averages", "Limits", blocks)


def _row(limit: LimitFound) -> tuple[Any, ...]:
    low, high = finite(limit.low), finite(limit.high)  # null in the file where it is non-finite
    width = (high - low) / 2 if low is not None and high is not None else 0.0
    digits = max(0, decimals([width], 2)) if width else None
    price, error = finite(limit.price), finite(limit.price_error)
    if price or error:
        value = measured(price, error, max(0, decimals([error], 2)) if error else 4)
    else:
        value = (NONE, "")
    return (
        limit.name,
        Mark(limit.met != "not met", limit.met),
        number(limit.level),
        number(limit.value, digits),
        f"{number(low, digits)}{SPACE}to{SPACE}{number(high, digits)}",
        *value,
    )


SECTIONS = (
    headline, limits, sensitivities, DISTRIBUTION, PROFILE, value_bounds, history, CERTIFICATE,
        making,
)  # fmt: skip
MENU = {
    "Limits": limits,
    "Sensitivities": sensitivities,
    "Totals": DISTRIBUTION,
    "Over time": PROFILE,
    "Bounds": value_bounds,
    "Checks": history,
}


def about(run: RunFiles) -> list[tuple[str, str]]:
    """The lines below the title of the report."""
    steps = f"{number(run.get('horizon'), 0)} {run.get('step', 'step')}s"
    objective = str(run.get("objective", ""))
    return [("Simulator", str(run.get("simulator", ""))), ("Horizon", steps),
            ("Objective", objective)]  # fmt: skip


REPORT = Report("A simulator of your own", RunFiles, about, SECTIONS, MENU)
