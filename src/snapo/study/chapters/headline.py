"""The value of a run with its standard error, and the numbers next to it."""

from snapo.report.evidence import gradient, notes
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Headline, Mark, Section
from snapo.report.quantity import SPACE, decimals, finite, number, part_of, plus_minus

from .certificate import checks

STATUS = {
    "ok": "done",
    "trained": "trained to the end",
    "stopped early": "training stopped early, as asked",
}


def headline(run: RunFiles) -> Section:
    """The value that a reader came for."""
    value, unit = run.result.value, run.unit
    if value is None:
        return Section("value", "Value", "Value", [why_missing(run, "training")])
    error = run.result.standard_error
    digits = decimals([value], 6) if not error else max(0, decimals([error], 2))
    text = f"{number(value, digits)}{SPACE}{unit}".rstrip(SPACE)
    objective = str(run.get("objective", "the objective"))
    note = f"{objective}, of the exact simulator on fresh paths; ± one standard error"
    available = plus_minus(error, digits)
    blocks: list[Block] = [Headline("Value", text, available, note, marks=marks(run)), *notes(run)]
    facts = _facts(run, value, digits)
    return Section("value", "Value", "Value", [*blocks, Facts(facts)] if facts else blocks)


def marks(run: RunFiles) -> list[Mark]:
    """The state of the run, and of its checks together."""
    status = run.result.status
    result = [Mark(status in STATUS, STATUS.get(status, status))] if status else []
    held = [passed for _, passed in checks(run)]
    if held:
        result.append(Mark(all(held), f"{sum(held)} of {len(held)} checks hold"))
    return result


def _facts(run: RunFiles, value: float, digits: int) -> list[tuple[str, str, str]]:
    facts = []
    for name, item in run.result.references.items():
        if finite(item) is not None:
            facts.append((name.replace("_", " ").capitalize(), number(item, digits), run.unit))
    gap = run.result.smoothing_gap
    if gap is not None:
        share = f"{part_of(gap / abs(value))} of the value; " if value else ""
        facts.append(("Smoothing gap", number(gap), f"{share}exact less smooth simulator"))
    return [*facts, *gradient(run)]
