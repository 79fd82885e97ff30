"""The best recipe of the nominal model: decisions, limits, and the conditions that it meets."""

from typing import Any

from snapo.report.page import Block, Facts, Mark, Missing, Section, Table, Text
from snapo.report.quantity import (
    decimals,
    finite,
    number,
    percent,
    plus_minus,
    power,
    quantity,
    seconds,
)

from .run import Run


def optimum(run: Run) -> Section:
    """What `[optimise]` found."""
    title, short = "Best recipe", "Best recipe"
    found = run.get("optimise")
    if not found:
        text = f"No recipe was optimised: {run.why_not('best recipe', 'optimise')}."
        return Section("optimum", title, short, [Missing(text)])
    unit = str(found["unit"])
    blocks: list[Block] = [Text(_goal(found)), _facts(found, unit), _decisions(found, unit)]
    blocks.append(_limits(found, unit))
    if found["ramps"]:
        blocks.append(_ramps(found, unit))
    blocks.append(_conditions(found))
    return Section("optimum", title, short, blocks)


def _goal(found: dict[str, Any]) -> str:
    """The problem in a sentence."""
    goal = _sum(found["terms"])
    if found["per"]:
        goal = f"({goal}) / ({_sum(found['per'])})"
    kept = "all limits of the nominal model are kept"
    if found["reserve"]:
        kept += f", with {number(found['reserve'])} margins to spare"
    if found["deviations"]:
        kept += f", and {number(found['deviations'])} standard deviations of the batches to spare"
    word = "Largest" if found["sense"] == "maximise" else "Smallest"
    return f"{word} {goal} such that {kept}."


def _sum(terms: list[dict[str, Any]]) -> str:
    parts = []
    for each in terms:
        weight = "" if each["weight"] == 1 else f"{number(each['weight'])} "
        unit = "" if each["unit"] == "1" else f" [{each['unit']}]"
        parts.append(f"{weight}{each['of']}{unit}")
    return " + ".join(parts)


def _facts(found: dict[str, Any], unit: str) -> Facts:
    before, value = found["before"], found["value"]
    change = (value - before) / abs(before) if before else 0.0
    note = f"{percent(abs(change))} {'more' if change > 0 else 'less'}" if change else ""
    facts = [
        ("Goal, recipe as given", quantity(before, unit), ""),
        ("Goal, best recipe", quantity(value, unit), note),
    ]
    for name, each in zip(("as given", "best recipe"), found["chance"]):
        error = finite(each["error"])
        note = plus_minus(None if error is None else 100 * error, 1)
        facts.append((f"Chance of all limits, {name}", percent(each["probability"]), note))
    return Facts(facts)


def _decisions(found: dict[str, Any], unit: str) -> Table:
    rows = []
    for each in found["decisions"]:
        own = "" if each["unit"] == "1" else each["unit"]
        ends = f"{_fine(each['low'])} to {_fine(each['high'], own)}"
        worth = each["at_low"] or each["at_high"]
        side = "at its lower bound" if each["at_low"] else "at its upper bound"
        rows.append(
            (
                each["name"], ends, side if worth else "inside", _fine(each["start"], own),
                _fine(each["value"], own), number(worth) if worth else "0",
            )
        )  # fmt: skip
    head = [("Decision", ""), ("Bounds", ""), ("Where", ""), ("As given", ""), ("Best", ""),
            ("Multiplier", f"{unit} per unit")]  # fmt: skip
    caption = "The numbers chosen; a multiplier is the gain of the goal if its bound moves one unit"
    return Table(head, rows, caption, 3)


def _fine(value: float, unit: str = "") -> str:
    """Five significant digits, so that 273.15 K keeps its digits."""
    return quantity(value, unit, decimals([value]))


def _limits(found: dict[str, Any], unit: str) -> Table | Missing:
    rows = []
    for each in found["limits"]:
        own = "" if each["unit"] == "1" else each["unit"]
        rows.append(
            (
                each["attribute"], f"{each['side']} {quantity(each['limit'], own)}",
                "holds it" if each["worth"] else "free", _fine(each["start"], own),
                _fine(each["value"], own), number(each["worth"]) if each["worth"] else "0",
            )
        )  # fmt: skip
    if not rows:
        return Missing("No attribute has a limit, so that only the bounds hold the recipe.")
    head = [("Attribute", ""), ("Limit", ""), ("", ""), ("As given", ""), ("Best", ""),
            ("Multiplier", f"{unit} per unit")]  # fmt: skip
    caption = "Limits; a multiplier is the gain of the goal if the limit yields by one unit"
    return Table(head, rows, caption, 3)


def _ramps(found: dict[str, Any], unit: str) -> Table:
    rows = [
        (each["piece"], quantity(each["most"], each["unit"]), percent(each["used"], 0),
         number(each["worth"]) if each["worth"] else "0")
        for each in found["ramps"]
    ]  # fmt: skip
    head = [("Piece of a profile", ""), ("Ramp", ""), ("Used", ""), ("Multiplier", unit)]
    return Table(head, rows, "Ramps; a multiplier is per whole ramp more", 2)


def _conditions(found: dict[str, Any]) -> Table:
    tolerance = power(found["tolerance"])

    def small(value) -> Mark:
        good = finite(value) is not None and value <= found["tolerance"]
        return Mark(bool(good), f"{power(value)}, at most {tolerance}")

    ends = found["ends"]
    starts = "one start" if len(ends) == 1 else f"{len(ends)} starts, which ended at "
    if len(ends) > 1:
        starts += ", ".join(number(each) for each in ends)
    rows = [
        ("Solver", Mark(bool(found["converged"]), str(found["message"]))),
        ("Gradient that no multiplier of the right sign explains", small(found["stationarity"])),
        ("Largest violation of a limit, a ramp or a bound", small(found["violation"])),
        ("Work", f"{found['iterations']} iterations, {found['evaluations']} evaluations with all "
                 f"derivatives; {starts}"),
        ("Derivatives", found["mode"]),
        ("Time", f"{seconds(found['solving'])}, and {seconds(found['compiling'])} to compile"),
    ]  # fmt: skip
    return Table([], rows, "First-order conditions (Karush, Kuhn and Tucker), relative to the goal "
                 "at the start and to the width of the bounds", 2)  # fmt: skip
