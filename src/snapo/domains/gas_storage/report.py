"""The report of a storage run: its sections, its headline, and the separate picture."""

from pathlib import Path

import numpy as np

from snapo.report import charts
from snapo.report.drawing import LIGHT, draw_alone
from snapo.report.evidence import check_marks, making, notes
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Headline, Missing, Section
from snapo.report.quantity import (
    PLUS_MINUS,
    decimals,
    finite,
    long_date,
    number,
    percent,
    plus_minus,
    quantity,
    until,
)
from snapo.study.chapters.bound import optimum, value_bounds
from snapo.study.chapters.certificate import checks
from snapo.study.chapters.ladder import METHODS
from snapo.study.domain import Report

from .chapters.certificate import CERTIFICATE, assumptions, history
from .chapters.deltas import DELTAS, month_painter
from .chapters.gamma import GAMMA
from .chapters.hedge import HEDGE
from .chapters.position import POSITION, Cycles, Position, inventory
from .chapters.products import PRODUCT_DELTAS
from .chapters.quotes import QUOTE_DELTAS
from .chapters.risk import risk, sliders
from .chapters.run import StorageRun
from .chapters.today import FirstDecision, ladder
from .chapters.value import VALUES, ContractValue, cash_flow, ladder_bars
from .chapters.vega import VEGA

TONES = {"inject": "inject", "withdraw": "withdraw", "hold": "main"}


def headline(run: StorageRun) -> Section:
    """The value with its standard error, and the decision of the day in one sentence."""
    value, error = run.result.value, run.result.standard_error
    if value is None:
        status = run.result.status or "unknown"
        sentence = f"There is no value in result.json (status: {status})."
        return Section("headline", "Value and decision", "", [Missing(sentence)])
    digits, position = decimals([value]), POSITION.of(run) or Position()
    now = position.today or FirstDecision()
    block = Headline(
        label="Value of the contract",
        value=run.money(value, digits),
        error=plus_minus(error, digits),
        note=f"{PLUS_MINUS}; present value of the exact contract on fresh scenarios.",
        context=optimum(run),
        action=_verb(run, now) if now.action else "",
        sentence=_sentence(run, now) if now.action else "",
        tone=TONES.get(now.action, "main"),
        when=_when(run, now),
        marks=check_marks(checks(run)),
    )
    blocks: list[Block] = [block, *notes(run)]
    if not now.action:
        blocks.append(why_missing(run, POSITION.name))
    if facts := _facts(run, value, digits, position.cycles, now):
        blocks.append(Facts(facts))
    return Section("headline", "Value and decision", "", blocks)


def _when(run: StorageRun, now: FirstDecision) -> str:
    if now.date and now.date != run.get("valuation_date", now.date):
        return f"First decision, {long_date(now.date)}"
    return "Decision of today"


def _verb(run: StorageRun, now: FirstDecision) -> str:
    volume, verb = finite(now.volume), now.action.capitalize()
    return f"{verb} {run.gas(abs(volume))}" if now.action != "hold" and volume else verb


def _sentence(run: StorageRun, now: FirstDecision) -> str:
    """ "25 April 2021: the spot price is 16.61 with 1,500 MWh in store. The rule at this inventory
    is: …"."""
    price = run.price
    spot, low, high = (finite(x) for x in (now.spot, now.inject_below, now.withdraw_above))
    digits = _price_places([spot, low, high])
    limits = []
    if low is not None:
        limits.append(f"inject below {quantity(low, price, digits)}")
    if high is not None:
        limits.append(f"withdraw above {quantity(high, price, digits)}")
    rule = ", ".join(limits) + (" and hold between" if len(limits) == 2 else "")
    start = f"{long_date(now.date)}: the spot price is {quantity(spot, price, digits)}"
    store = finite(now.inventory)
    start += f" with {run.gas(store)} in store." if store is not None else "."
    return f"{start} The rule at this inventory is: {rule}." if rule else start


def _price_places(prices) -> int:
    """Two decimals for prices of usual size, more for small prices."""
    return max(2, min(decimals(prices, 4), 6))


def _facts(
    run: StorageRun, value: float, digits: int, cycles: Cycles, now: FirstDecision
) -> list[tuple[str, str, str]]:
    facts = []
    intrinsic = finite(run.result.references.get("intrinsic"))
    if intrinsic is not None:
        facts.append(("Intrinsic value", run.money(intrinsic, digits), "locked in today"))
        share = f"{percent((value - intrinsic) / value)} of the value" if value else ""
        facts.append(("Extrinsic value", run.money(value - intrinsic, digits), share))
    values = VALUES.of(run)
    if values is not None and (fee := finite(values.break_even_fee)) is not None:
        note = f"per {run.volume} of working volume"
        facts.append(("Break-even fee", run.money(fee, max(2, decimals([fee], 4))), note))
    if finite(cycles.mean) is not None:
        facts.append(("Cycles", number(cycles.mean, 2), f"{cycles.unit}, mean"))
    if finite(now.marginal_value) is not None:
        note = f"of one more {run.volume} in store today"
        facts.append(("Marginal value", quantity(now.marginal_value, run.price, 2), note))
    return facts


HEADING = {"loc": "left", "pad": 26, "color": LIGHT["ink"], "fontweight": "bold"}


def today(run: StorageRun) -> Section:
    """The decision of today, from the chapter on the store over time."""
    position = POSITION.of(run)
    return ladder(run, None if position is None else position.today)


SECTIONS = (
    headline, today, VALUES, METHODS, value_bounds, cash_flow, POSITION, inventory, DELTAS,
    QUOTE_DELTAS, PRODUCT_DELTAS, VEGA, GAMMA, HEDGE, risk, sliders, history, CERTIFICATE,
    assumptions, making,
)  # fmt: skip
MENU = {
    "Today": today,
    "Value": VALUES,
    "Store": POSITION,
    "Deltas": DELTAS,
    "Risk": risk,
    "Checks": history,
}


def _about(run: StorageRun) -> list[tuple[str, str]]:
    pairs = []
    if run.get("valuation_date"):
        pairs.append(("Valuation date", long_date(run.get("valuation_date"))))
    if run.get("start") and run.get("end"):
        dates = f"{long_date(run.get('start'))} to {until(run.get('end'))}"
        pairs.append(("Contract", dates))
    if run.days:
        pairs.append(("Decision days left", f"{len(run.days):,}"))
    if run.currency:
        pairs.append(("Units", f"{run.currency}, {run.volume}"))
    return pairs


REPORT = Report("Gas storage", StorageRun, _about, SECTIONS, MENU)


def readme_picture(folder: Path, exact: float | None = None) -> str:
    """A separate picture of a result, as SVG text: the value ladder and the monthly deltas.

    `exact`: the contract's value by dynamic programming from another run, for a run without
    `--reference`. Raises `ValueError` if the run lacks the value ladder or the deltas.
    """
    run = StorageRun.read(Path(folder))
    values, deltas = VALUES.of(run), DELTAS.of(run)
    months = deltas.deltas_monthly if deltas else ()
    if (
        values is None
        or not values.value_of
        or not any(np.isfinite(x.undiscounted) for x in months)
    ):
        raise ValueError("the run has no `value_ladder` or no `deltas_monthly`.")
    ladder, name = values.value_of, "Dynamic programming"
    if exact is not None and all(x.name != name for x in ladder):
        below_bound = len(ladder) - (ladder[-1].name == "Upper bound")
        ladder.insert(below_bound, ContractValue(name, exact))

    def paint(left, right):
        charts.ladder(left, ladder_bars(run, ladder))
        left.set_title("Value of the contract", **HEADING)
        month_painter(run, months)(right)
        right.set_title(f"Delta by delivery month, {run.volume}", **HEADING)

    title = f"{run.get('title', 'Gas storage')}: value ladder and deltas by delivery month"
    return draw_alone(title, paint, (900.0, 280.0), (1.0, 1.25))
