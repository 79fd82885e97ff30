"""Purpose, model and numbers, as a reader who must judge them needs them."""

from ....report.page import Block, Missing, Section, Table, Text
from ....report.quantity import number, quantity
from .run import Run


def model(run: Run) -> Section:
    """Purpose, flowsheet, equations, parameters with their sources, and what is uncertain."""
    blocks: list[Block] = []
    if run.get("purpose"):
        blocks.append(Text(str(run.get("purpose"))))
    if run.get("scope"):
        blocks.append(Text(str(run.get("scope")), caveat=True))
    units = run.get("units", [])
    if not units:
        blocks.append(Missing("details.json does not say what the flowsheet is."))
    flow = [f"{c['from']} → {c['to']}" for c in run.get("connections", [])]
    if flow:
        blocks.append(Text("Flowsheet: " + "; ".join(flow) + "."))
    blocks += [_reactions(run), _equations(units), _parameters(run), _uncertainty(run)]
    blocks.append(_numbers(run))
    return Section("model", "Purpose, model and equations", "Model", blocks)


def _reactions(run: Run) -> Table | Text:
    rows = [
        (
            each["name"],
            each["equation"],
            each["rate"],
            quantity(each["prefactor"], each["prefactor_unit"]),
            quantity(each["activation"] / 1000, "kJ/mol"),
        )
        for each in run.get("reactions", [])
    ]
    if not rows:
        return Text("Nothing reacts.")
    head = [("Reaction", ""), ("Equation", ""), ("Rate", ""), ("Prefactor", ""), ("Activation", "")]
    return Table(head, rows, "Mass-action reactions; k = prefactor exp(−E/(R T))", 3)


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
            quantity(each["nominal"], "" if each["unit"] == "1" else each["unit"]),
            " – ".join(number(x) for x in each["normal"]),
            " – ".join(number(x) for x in each["range"]),
            each["distribution"],
        )
        for each in run.parameters
    ]
    if not rows:
        return Missing("The process parameters are not in this run.")
    head = [("Parameter", ""), ("What it is", ""), ("Source", ""), ("Set point", ""),
            ("Normal range", ""), ("Studied range", ""), ("Varies", "")]  # fmt: skip
    return Table(head, rows, "Process parameters", 3)


def _uncertainty(run: Run) -> Table | Text:
    rows = [
        (each["of"], each["distribution"], each["when"], quantity(each["nominal"], each["unit"]))
        for each in run.get("uncertainty", [])
    ]
    if not rows:
        return Text("Every number of the model counts as known exactly.")
    head = [("Number", ""), ("Distribution", ""), ("New in every", ""), ("Nominal", "")]
    return Table(head, rows, "Numbers of the model that are not known exactly", 3)


def _numbers(run: Run) -> Table | Missing:
    rows = [
        (each["input"], each["label"], each["parameter"], quantity(each["value"], each["unit"]))
        for each in run.get("numbers", [])
    ]
    if not rows:
        return Missing("The numbers of the model are not in this run.")
    head = [("Input", ""), ("Entry", ""), ("Parameter", ""), ("Value", "")]
    return Table(head, rows, "In the units of the computation", 3, folded="Every number")
