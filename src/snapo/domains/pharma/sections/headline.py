"""The first screen: the chance that a batch keeps all limits, and every attribute's value."""

from snapo.report.page import Block, Facts, Headline, Mark, Missing, Section, Table
from snapo.report.quantity import finite, number, percent, plus_minus, quantity
from snapo.study.domain import GOOD

from ..results.checks import checks
from .run import Run, limits


def headline(run: Run) -> Section:
    """Probability of all limits, and the table of attributes at the set point."""
    title = "Quality at the set point"
    value, error = finite(run.result.get("value")), finite(run.result.get("standard_error"))
    blocks: list[Block] = []
    if value is None:
        status = run.result.get("status") or "unknown"
        blocks.append(Missing(f"There is no probability in this run (status: {status})."))
    else:
        blocks.append(
            Headline(
                label="Probability that a batch keeps all limits",
                value=percent(value),
                error=plus_minus(None if error is None else 100 * error, 1),
                note=_note(run),
                marks=_marks(run),
            )
        )
    if facts := _facts(run):
        blocks.append(Facts(facts))
    blocks.append(_table(run))
    return Section("headline", title, "", blocks)


def _note(run: Run) -> str:
    who = "of the trained policy" if run.get("closed_loop") else "of the recipe as given"
    if run.result.get("verdict"):
        return f"{run.result['verdict']} ± one standard error of the sample, in percentage points."
    return (
        f"{who}, over the batch-to-batch variation that the case states; ± one standard error of "
        "the sample, in percentage points."
    )


def _marks(run: Run) -> list[Mark]:
    """Verdicts on the numbers, then on the process; nothing good stands above a bad status."""
    found, state = checks(run), str(run.result.get("status") or "ok")
    failed = [name for name, good in found if not good]
    marks = []
    if failed:
        words = f"{len(failed)} of {len(found)} numerical checks fail: {', '.join(failed)}"
        marks = [Mark(False, words)]
    elif state not in GOOD:
        marks = [Mark(False, state)]
    elif found:
        all_of_them = f"all {len(found)} numerical checks hold"
        marks = [Mark(True, all_of_them if len(found) > 1 else "the numerical check holds")]
    return [*marks, *_quality(run)]


def _quality(run: Run) -> list[Mark]:
    """What speaks against the process, however good the numbers are."""
    rows, found = run.get("ranges", []), []
    holds = run.get("run.holds", [])
    broken = [each["name"] for each, good in zip(run.attributes, holds) if not good]
    outside = [each["parameter"] for each in rows if not each["probable"]["holds_normal"]]
    unsure = [each["parameter"] for each in rows if not each["probable"].get("sure_normal")]
    for words, names in (
        ("at the set point a limit is broken", broken),
        ("normal ranges not inside the proven ones", outside),
        (
            "normal ranges inside the proven ones, but not surely at 95 %",
            [name for name in unsure if name not in outside],
        ),
    ):
        if names:
            found.append(Mark(False, f"{words}: {', '.join(names)}"))
    chance = run.get("optimise.chance")
    if chance and chance[1]["probability"] < chance[0]["probability"] - 3 * chance[1]["error"]:
        pair = f"{percent(chance[1]['probability'])} for {percent(chance[0]['probability'])}"
        words = f"the optimised recipe keeps all limits less often, {pair}: keep a reserve"
        found.append(Mark(False, words))
    return found


def _facts(run: Run) -> list[tuple[str, str, str]]:
    facts = []
    ranking = run.get("matrix.ranking", [])
    if ranking and ranking[0].get("attribute"):
        first = ranking[0]
        share, attribute = percent(first.get("share"), 0), first["attribute"]
        note = f"its normal range uses {share} of the room that batches leave to {attribute}"
        if first.get("outside"):
            note = f"{attribute} is beyond its limit"
        elif first.get("spent"):
            note = f"for {attribute}, of which variation alone takes the room"
        facts.append(("Most critical parameter", first["parameter"], note))
    box = run.get("design_space.box")
    if box:
        facts.append(("Largest box inside", percent(box["volume"], 0), "of the studied range"))
    joint = finite(run.get("capability.joint"))
    if joint is not None:
        batches = number(run.get("capability.batches"), 0)
        note = f"of {batches} simulated batches"
        facts.append(("Out of specification, recipe as given", percent(joint), note))
    loop = run.get("closed_loop")
    if loop:
        error = plus_minus(100 * loop["baseline_error"], 1)
        facts.append(("All limits, best fixed recipe", percent(loop["baseline"]), error))
    return facts


def _table(run: Run) -> Table | Missing:
    values = run.get("run.attributes")
    if not values:
        return Missing("No batch was computed, so the attributes have no values.")
    rows = []
    for i, each in enumerate(run.attributes):
        unit = "" if each["unit"] == "1" else each["unit"]
        holds = run.get("run.holds", [])
        known = each["low"] is not None or each["high"] is not None
        room = (run.get("run.distance") or [None] * (i + 1))[i]
        rows.append(
            (
                each["name"],
                limits(each),
                each["citation"] or "–",
                Mark(bool(holds[i]), "holds" if holds[i] else "broken") if known else "–",
                quantity(values.get(each["name"]), unit),
                quantity(room, unit) if known else "–",
            )
        )
    head = [("Attribute", ""), ("Limit", ""), ("Where it stands", ""), ("", ""), ("Value", ""),
            ("Room to the limit", "")]  # fmt: skip
    return Table(head, rows, "Quality attributes of one batch at the set point", 4)
