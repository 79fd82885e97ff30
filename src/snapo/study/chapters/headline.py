"""The value of a run with its interval, and the numbers next to it."""

from snapo.report.evidence import check_marks, gradient, notes
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Headline, Mark, Section, Text
from snapo.report.quantity import (
    PLUS_MINUS,
    SPACE,
    decimals,
    finite,
    measured,
    number,
    part_of,
    plus_minus,
)

from .bound import optimum
from .certificate import checks

STATUS = {
    "ok": "done",
    "trained": "trained to the end",
    "stopped early": "training stopped early, as requested",
}


def headline(run: RunFiles) -> Section:
    """The value of the run as the headline of its report."""
    value, unit = run.result.value, run.unit
    if value is None:
        return Section("value", "Value", "Value", [why_missing(run, "training")])
    error = run.result.standard_error
    digits = decimals([value], 6) if not error else max(0, decimals([error], 2))
    text = f"{number(value, digits)}{SPACE}{unit}".rstrip(SPACE)
    if unit and unit == run.currency:
        text = run.money(value, digits)
    objective = str(run.get("objective", "the objective"))
    objective = objective[:1].upper() + objective[1:]
    note = f"{objective}, under the exact rules on fresh paths; {PLUS_MINUS}"
    available = plus_minus(error, digits)
    top = Headline("Value", text, available, note, marks=marks(run), context=optimum(run))
    blocks: list[Block] = [top, *notes(run)]
    facts = _facts(run, value, digits)
    return Section("value", "Value", "Value", [*blocks, Facts(facts)] if facts else blocks)


def common_paths(run: RunFiles) -> list[Text]:
    """A text that compares the trained policy with its starting rule on the same paths, since the
    values in the table are from different paths; empty if they were not compared."""
    gain, error = (finite(run.get(f"solution.{name}")) for name in ("gain", "gain_error"))
    if run.get("solution.selected") == "start":
        text = "The policy of this run is its starting rule, because training did not improve it"
        return [Text(f"{text}; on common paths their difference is 0.")]
    if gain is None:
        return []
    more = "more" if gain >= 0 else "less"
    value, half = measured(abs(gain), error, max(0, decimals([error or gain], 2)))
    unit = f"{run.unit} " if run.unit else ""
    sentence = f"the policy earns {unit}{value} {half} {more} than the rule that it began with"
    return [Text(f"On common paths {sentence}.")]


def marks(run: RunFiles) -> list[Mark]:
    """The state of the run, and the result of all its checks."""
    status = run.result.status
    result = [Mark(status in STATUS, STATUS.get(status, status))] if status else []
    return [*result, *check_marks(checks(run))]


def _facts(run: RunFiles, value: float, digits: int) -> list[tuple[str, str, str]]:
    facts = []
    for name, item in run.result.references.items():
        if finite(item) is not None:
            facts.append((name.replace("_", " ").capitalize(), number(item, digits), run.unit))
    gap = run.result.smoothing_gap
    if gap is not None:
        share = f"{part_of(gap / abs(value))} of the value; " if value else ""
        facts.append(("Smoothing gap", number(gap), f"{share}exact minus smooth simulator"))
    return [*facts, *gradient(run)]
