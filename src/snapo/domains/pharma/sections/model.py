"""Purpose, model and numbers, as a reader who must judge them needs them."""

import re

from snapo.report.page import Block, Missing, Section, Table, Text
from snapo.report.quantity import finite, raised, unit_words

from .run import Run

POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def model(run: Run) -> Section:
    """Purpose, flowsheet, equations, parameters with their sources, and uncertain numbers."""
    blocks: list[Block] = []
    if run.get("purpose"):
        blocks.append(Text(str(run.get("purpose"))))
    if run.get("scope"):
        blocks.append(Text(str(run.get("scope")), caveat=True))
    units = run.get("units", [])
    if not units:
        blocks.append(Missing("This run does not say what the flowsheet is."))
    flow = [f"{c['from']} → {c['to']}" for c in run.get("connections", [])]
    if flow:
        blocks.append(Text("Flowsheet: " + "; ".join(flow) + "."))
    blocks += [_reactions(run), _equations(units)]
    if run.get("symbols"):
        blocks.append(Text(f"Symbols: {run.get('symbols')}."))
    blocks.append(_parameters(run))
    blocks.append(_uncertainty(run))
    blocks.append(_numbers(run))
    return Section("model", "Purpose, model and equations", "Model", blocks)


def given(value: float, unit: str = "") -> str:
    """A number that the case gives, with all its digits: 313.15 K, 4.46 × 10¹⁰ 1/m3/s."""
    if value == 0 or 1e-3 <= abs(value) < 1e7:
        text = f"{value:,.10f}".rstrip("0").rstrip(".").replace("-", "−")
        if value != float(f"{value:.10f}"):
            text = f"{value:.10g}".replace("-", "−")
    else:
        mantissa, _, power = f"{value:.9e}".partition("e")
        shown = str(int(power)).translate(POWERS)
        text = f"{mantissa.rstrip('0').rstrip('.')} × 10{shown}".replace("-", "−")
    return f"{text}\u00a0{unit_words(unit)}" if unit and unit != "1" else text


def place(value: float | None, unit: str = "") -> str:
    """A place on a parameter's axis: five digits, with which 313.15 K stays what it is."""
    known = finite(value)
    return "–" if known is None else given(float(f"{known:.5g}"), unit)


def _reactions(run: Run) -> Table | Text:
    rows = [
        (
            each["name"],
            each["equation"],
            each["rate"],
            given(each["prefactor"], each["prefactor_unit"]),
            given(each["activation"] / 1000, "kJ/mol"),
            given(each["heat"] / 1000, "kJ/mol"),
        )
        for each in run.get("reactions", [])
    ]
    if not rows:
        return Text("Nothing reacts.")
    head = [("Reaction", ""), ("Equation", ""), ("Rate", ""), ("Prefactor", ""), ("Activation", ""),
            ("Heat of reaction", "")]  # fmt: skip
    reference = run.get("reactions")[0]["reference"]
    power = "E/(R T)" if reference is None else f"E/R (1/T − 1/{given(reference, 'K')})"
    return Table(head, rows, f"Mass-action reactions; k = prefactor exp(−{power})", 3)


def _equations(units) -> Table | Missing:
    if not units:
        return Missing("The equations of the units are not in this run.")
    rows = [(each["name"], each["type"], "; ".join(each["equations"])) for each in units]
    return Table([("Unit", ""), ("Type", ""), ("Equations", "")], rows, "Model of each unit", 3)


def _parameters(run: Run) -> Table | Missing:
    rows = [
        (
            each["name"],
            each["of"],
            each["source"],
            given(each["nominal"], each["unit"]),
            " – ".join(given(x) for x in each["normal"]),
            " – ".join(given(x) for x in each["range"]),
            each["distribution"],
        )
        for each in run.parameters
    ]
    if not rows:
        return Missing("The process parameters are not in this run.")
    head = [("Parameter", ""), ("What it is", ""), ("Source", ""), ("Set point", ""),
            ("Normal range", ""), ("Studied range", ""), ("Varies", "")]  # fmt: skip
    return Table(head, rows, "Process parameters", frozenset({0, 1, 2, 6}))


def _uncertainty(run: Run) -> Table | Text:
    rows = [
        (each["of"], each["distribution"], each["when"], given(each["nominal"], each["unit"]))
        for each in run.get("uncertainty", [])
    ]
    if not rows:
        return Text("Every number of the model counts as known exactly.")
    head = [("Number", ""), ("Distribution", ""), ("New in every", ""), ("Nominal", "")]
    return Table(head, rows, "Numbers of the model that are not known exactly", 3)


def _numbers(run: Run) -> Table | Missing:
    rows = [
        (each["input"], label, each["parameter"], given(each["value"], unit))
        for each in run.get("numbers", [])
        for label, unit in [_of_power(each["label"], each["unit"])]
    ]
    if not rows:
        return Missing("The numbers of the model are not in this run.")
    head = [("Input", ""), ("Entry", ""), ("Parameter", ""), ("Value", "")]
    return Table(head, rows, "In the units of the computation", 3, folded="Every number")


def _of_power(label: str, unit: str) -> tuple[str, str]:
    """A coefficient's label and unit as written by hand: "t^2", "kg/m3/K^k" as "t²", "kg/m3/K2"."""
    found = re.fullmatch(r"t\^(\d+)", label)
    if found is None:
        return label, unit
    own = {"0": "", "1": "/K"}.get(found[1], f"/K{found[1]}")
    text = unit.replace("/K^k", own)
    return f"t{raised(found[1])}", "" if text == "1" else text
