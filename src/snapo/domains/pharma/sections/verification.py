"""Why to believe the numbers: balances, convergence, adjoint against differences."""

from typing import Any

from snapo.report.page import Block, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, power

from ..results.checks import closed
from .run import Run


def verification(run: Run) -> Section:
    """Every check that this very run was put to."""
    blocks: list[Block] = [_balances(run), *_loops(run), *_convergence(run), *_cells(run)]
    blocks.append(_certificate(run))
    closure = finite(run.get("attribution.closure"))
    if closure is not None:
        blocks.append(
            Text(
                "Sensitivities put together from the units' own derivatives along every path agree "
                f"with those of the whole to {power(closure)} of the largest in their row."
            )
        )
    return Section("verification", "Verification", "Verification", blocks)


def _balances(run: Run) -> Table | Missing:
    rows = run.get("balances")
    if not rows:
        return Missing("The balances of this run were not computed.")
    body = [
        (
            each["unit"],
            each["quantity"],
            Mark(closed(each), "closes" if closed(each) else "open"),
            number(each["inflow"]),
            number(_made(each)),
            number(each["outflow"]),
            number(each["accumulation"]),
            power(abs(each["relative"])),
        )
        for each in rows
    ]
    names = ("Unit", "Balance of", "", "In", "Made", "Out", "Stays", "Relative gap")
    head = [(name, "") for name in names]
    caption = (
        "Balances of one batch: mass and solvent in kg, species in kmol, energy in J. Made: by "
        "reactions, below 0 where they use a species; of mass, what rounded molar masses leave over"
    )
    return Table(head, body, caption, 3)


def _made(each: dict[str, Any]) -> float:
    """What was made; what rounding alone leaves of it is nothing."""
    through = max(abs(each["inflow"]), abs(each["outflow"]))
    return each["made"] if abs(each["made"] or 0.0) > 1e-12 * through else 0.0


def _loops(run: Run) -> list[Block]:
    return [
        Text(
            f"The loop {each['loop']} is at its steady state: one more turn changes its torn "
            f"streams by {power(each['change'])} of themselves, after {each['rounds']} rounds of "
            "Newton's method."
        )
        for each in run.get("run.loops", [])
        if each["change"] is not None
    ]


def _convergence(run: Run) -> list[Block]:
    rows = run.get("convergence.rows")
    if not rows:
        return [Missing("Convergence in time was not examined in this run.")]
    worst = max(rows, key=lambda row: abs(row["halving_gap"] or 0.0))
    other = max(rows, key=lambda row: abs(row["adaptive_gap"] or 0.0))
    body = [
        (
            row["attribute"],
            row["parameter"],
            number(row["mesh"]),
            number(row["finer"]),
            number(row["adaptive"]),
            power(row["halving_gap"]),
            power(row["adaptive_gap"]),
        )
        for row in rows
    ]
    controlled = run.get("numerics.method") == "adaptive"
    finer = "A tenth of the tolerance" if controlled else "Half the mesh"
    head = [("Attribute", ""), ("By", ""), ("As in this run", ""), (finer, ""),
            ("Error-controlled", ""), ("Finer gap", ""), ("Adaptive gap", "")]  # fmt: skip
    text = (
        f"{'With' if controlled else 'On'} {finer.lower()} no value or derivative moves by more "
        f"than {power(worst['halving_gap'])} (values relative to themselves, "
        "derivatives to the largest in their row); the "
        f"error-controlled solution differs by at most {power(other['adaptive_gap'])}."
    )
    table = Table(head, body, "Values and derivatives in three ways", 2, folded="Every number")
    return [Text(text), table]


def _cells(run: Run) -> list[Block]:
    rows = run.get("convergence.cells")
    if not rows:
        return []
    body = [
        (
            row["attribute"],
            Mark(bool(row["passed"]), "within its margin" if row["passed"] else "moves"),
            number(row["value"]),
            number(row["finer"]),
            number(row["margins"]),
        )
        for row in rows
    ]
    head = [("Attribute", ""), ("", ""), ("Value", ""), ("Twice the cells", ""),
            ("Change in margins", "")]  # fmt: skip
    caption = "Attributes on twice as many cells along tubes and over the sizes of crystals"
    return [Table(head, body, caption, 2)]


def _certificate(run: Run) -> Table | Missing:
    rows = run.get("certificate")
    if not rows:
        return Missing("The adjoint was not checked against differences in this run.")
    body = [
        (
            each["point"],
            Mark(bool(each["passed"]), "agrees" if each["passed"] else "differs"),
            f"{each['attribute']} by {each['parameter']}",
            number(each["kinks"], 0),
            power(each["worst"]),
        )
        for each in rows
    ]
    head = [("Point", ""), ("", ""), ("Worst entry", ""), ("Kinks", ""), ("Gap", "")]
    caption = (
        "Adjoint against fourth-order central differences, every attribute by every parameter; "
        "gap over the largest of the row; at a kink both one-sided derivatives differ"
    )
    return Table(head, body, caption, 3)
