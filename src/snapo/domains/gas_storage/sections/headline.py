"""The first screen: the worth of the contract and the decision of today."""

from snapo.report.evidence import notes
from snapo.report.page import Block, Facts, Headline, Mark, Missing, Section
from snapo.report.quantity import (
    decimals,
    finite,
    long_date,
    number,
    part_of,
    percent,
    plus_minus,
    quantity,
)
from snapo.report.sections.lacking import lacking
from snapo.study.chapters.certificate import checks

from .run import Run

TONES = {"inject": "inject", "withdraw": "withdraw", "hold": "main"}


def headline(run: Run) -> Section:
    """The value with its standard error, and the decision of the day in one sentence."""
    value, error = finite(run.result.get("value")), run.result.get("standard_error")
    if value is None:
        status = run.result.get("status") or "unknown"
        sentence = f"There is no value in result.json (status: {status})."
        return Section("headline", "Value and decision", "", [Missing(sentence)])
    places = decimals([value])
    action = str(run.get("today.action", ""))
    block = Headline(
        label="Value of the contract",
        value=run.money(value, places),
        error=plus_minus(error, places),
        note=_error_note(value, error),
        action=_verb(run) if action else "",
        sentence=_sentence(run) if action else "",
        tone=TONES.get(action, "main"),
        when=_when(run),
        marks=_marks(run),
    )
    blocks: list[Block] = [block, *notes(run)]
    if not action:
        blocks.append(lacking(run, "profile"))
    if facts := _facts(run, value, places):
        blocks.append(Facts(facts))
    return Section("headline", "Value and decision", "", blocks)


def _error_note(value: float, error) -> str:
    known = finite(error)
    text = "exact contract on fresh scenarios, present value"
    if known is None:
        return f"{text[0].upper()}{text[1:]}."
    share = f" ({part_of(known / abs(value))} of the value)" if value else ""
    return f"± one standard error{share}; {text}."


def _marks(run: Run) -> list[Mark]:
    found = checks(run)
    failed = [name for name, passed in found if not passed]
    if not found:
        return []
    if failed:
        return [Mark(False, f"{len(failed)} of {len(found)} checks fail; see the certificate")]
    return [Mark(True, f"all {len(found)} checks of the certificate hold")]


def _when(run: Run) -> str:
    day = run.get("today.date")
    if day and day != run.get("valuation_date", day):
        return f"First decision, {long_date(day)}"
    return "Decision of today"


def _verb(run: Run) -> str:
    action, volume = str(run.get("today.action")), finite(run.get("today.volume"))
    verb = action.capitalize()
    return f"{verb} {run.gas(abs(volume))}" if action != "hold" and volume else verb


def _sentence(run: Run) -> str:
    """ "25 April 2021: spot is 16.61, above the withdrawal trigger of 16.20 …"."""
    price = run.price
    spot, low, high = (
        finite(run.get(f"today.{key}")) for key in ("spot", "inject_below", "withdraw_above")
    )
    places = _price_places([spot, low, high])
    parts = []
    if low is not None:
        parts.append(f"inject below {quantity(low, price, places)}")
    if high is not None:
        parts.append(f"withdraw above {quantity(high, price, places)}")
    rule = ", ".join(parts) + (" and hold between" if len(parts) == 2 else "")
    day = long_date(run.get("today.date", ""))
    store = finite(run.get("today.inventory"))
    start = f"{day}: the spot price is {quantity(spot, price, places)}"
    start += f" with {run.gas(store)} in store." if store is not None else "."
    return f"{start} The rule at this inventory: {rule}." if rule else start


def _price_places(prices) -> int:
    """Cents for prices of everyday size, more for small ones."""
    return max(2, min(decimals(prices, 4), 6))


def _facts(run: Run, value: float, places: int) -> list[tuple[str, str, str]]:
    facts = []
    intrinsic = finite(run.result.get("intrinsic"))
    if intrinsic is None:
        intrinsic = finite((run.result.get("references") or {}).get("intrinsic"))
    if intrinsic is not None:
        facts.append(("Intrinsic value", run.money(intrinsic, places), "locked in today"))
        share = f"{percent((value - intrinsic) / value)} of the value" if value else ""
        facts.append(("Extrinsic value", run.money(value - intrinsic, places), share))
    fee = finite(run.get("break_even_fee"))
    if fee is not None:
        note = f"per {run.volume} of working volume"
        facts.append(("Break-even fee", run.money(fee, max(2, decimals([fee], 4))), note))
    cycles = finite(run.get("cycles.mean"))
    if cycles is not None:
        facts.append(
            (
                "Cycles",
                number(cycles, 2),
                str(run.get("cycles.unit", "injected volume / working volume")) + ", mean",
            )
        )
    marginal = finite(run.get("today.marginal_value"))
    if marginal is not None:
        note = f"of one more {run.volume} in store today"
        facts.append(("Marginal value", quantity(marginal, run.price, 2), note))
    return facts
