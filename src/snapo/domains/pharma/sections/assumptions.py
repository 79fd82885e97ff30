"""Assumptions, notes, timings, versions and hashes: how to get this report again."""

from snapo.report.evidence import spent
from snapo.report.page import Block, Facts, Missing, Section, Table, Text
from snapo.report.quantity import number, seconds

from .run import Run


def assumptions(run: Run) -> Section:
    """Assumptions of the model, remarks, and the versions behind the numbers."""
    blocks: list[Block] = [Text(str(text)) for text in run.get("assumptions", [])]
    if not blocks:
        blocks.append(Missing("The assumptions are not in this run."))
    blocks += [Text(str(note), caveat=True) for note in [*run.get("notes", []), *_notes(run)]]
    times = spent(run)
    if times.get("total") is not None:
        blocks.append(Facts([("Whole study", seconds(times["total"]), "wall clock")]))
    rows = [(name.capitalize(), seconds(each)) for name, each in times.items() if name != "total"]
    if rows:
        blocks.append(Table([("Part", ""), ("Time", "")], rows, folded="Time of every part"))
    blocks.append(_made_with(run))
    title = "Assumptions, versions and hashes"
    return Section("assumptions", title, "Assumptions", blocks)


def _notes(run: Run) -> list[str]:
    """Remarks that the run itself makes: parts that failed, and a coarser mesh."""
    found = [
        f"{name} failed: {each['note']}" for name, each in run.parts.items() if each.get("note")
    ]
    steps = run.get("sampling.steps")
    if steps is not None and steps != run.get("run.steps", run.get("numerics.steps")):
        found.append(
            f"Statistics of many batches use {steps} steps per piece, which moves no attribute by "
            f"more than {run.get('sampling.gap'):.1g} of its margin."
        )
    return found


def _made_with(run: Run) -> Table | Missing:
    rows = [("Seed", number(run.get("seed"), 0))] if run.get("seed") is not None else []
    numerics = run.get("numerics") or {}
    if numerics:
        steps = run.get("run.steps", numerics["steps"])
        rows.append(("Integration", f"{numerics['method']}, {steps} steps per piece, "
                     f"tolerance {numerics['tolerance']:g}"))  # fmt: skip
    for unit, error in (run.get("run.errors") or {}).items():
        text = f"stiff: Rosenbrock steps (Rodas5P), error of a step at most {error:.1g}"
        rows.append((f"Integration of {unit}", text))
    versions = run.get("versions", {}) | run.get("libraries", {})
    if versions:
        rows.append(("Versions", ", ".join(f"{k} {v}" for k, v in versions.items())))
    rows += [(f"SHA-256 of {name}", text) for name, text in (run.get("hashes") or {}).items()]
    if not rows:
        return Missing("Seed, versions and hashes are not in this run.")
    return Table([], rows, "How to get these numbers again", 2)
