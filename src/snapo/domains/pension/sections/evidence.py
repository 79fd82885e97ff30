"""Evidence for the numbers: training history, certificate, assumptions and versions."""

from snapo.report import evidence
from snapo.report.page import Block, Facts, Section, Table, Text
from snapo.report.quantity import finite, number
from snapo.report.sections.lacking import not_asked
from snapo.study.chapters.certificate import Certificate, bump_table, certificate, limit_table
from snapo.study.chapters.certificate import checks as certified

from .run import PensionRun
from .words import name_of


def checks(run: PensionRun) -> list[tuple[str, bool]]:
    """(name of a check, whether it held) for every check with a verdict."""
    found = [
        (str(each.get("name", "")).replace("_", " "), bool(each["ok"]))
        for path in ("reconciliation.lines", "market_consistency")
        for each in run.get(path, [])
        if each.get("ok") is not None and each.get("given", 0.0) is not None
    ]
    return [*found, *certified(run)]


def history(run: PensionRun) -> Section:
    """The objective and the gradient norm over the steps of training."""
    return evidence.history(run, "objective")


def show_certificate(run: PensionRun, result: Certificate) -> list[Block]:
    """The adjoint against bumps, and every limit."""
    gap = number(result.smoothing_gap)
    facts = [("Smoothing gap", gap, "exact less smooth, in the objective")]
    return [
        Facts([*facts, *evidence.gradient(run)]),
        bump_table(result, "", name_of),
        limit_table(result, "", "Step", _step),
    ]


CERTIFICATE = certificate(tolerance=lambda problem: 1e-9, show=show_certificate)  # of a share


def _step(step) -> str:
    return number((finite(step) or 0) + 1, 0)


def assumptions(run: PensionRun) -> Section:
    """Model, notes, kinds of assets, inputs held fixed, engine, seed and versions."""
    model = run.get("model")
    blocks: list[Block] = [*([Text(str(model))] if model else []), *evidence.notes(run)]
    blocks += not_asked(run)
    if kinds := run.get("kinds", {}):
        rows = [(name.capitalize(), str(words)) for name, words in kinds.items()]
        blocks.append(Table([("Kind", ""), ("Meaning", "")], rows, "Kinds of assets", 2))
    held = run.get("held", [])
    if held:
        names = ", ".join(name_of(each).lower() for each in held)
        blocks.append(Text(f"Held fixed, without a sensitivity: {names}.", caveat=True))
    blocks += [*evidence.times(run), evidence.made_with(run), _glossary()]
    return Section("assumptions", "Assumptions, versions and terms", "Assumptions", blocks)


def _glossary() -> Table:
    rows = [
        ("P, Q", "real-world and risk-neutral scenarios; stands beside everything simulated"),
        ("Funding ratio F", "assets over liability, both at the same instant"),
        ("Certainty equivalent", "the sure ratio with the utility of the policy's own"),
        ("KR01, IE01", "change for +1 bp at one node of the nominal or break-even curve"),
        ("Hedge ratio", "rate sensitivity of assets and swaps over that of the liability"),
        ("Headroom", "rise in rates until the swaps' losses use up the eligible assets"),
        ("CVaR 95 %", "the mean of the worst 5 % of paths"),
        (
            "Standard error",
            "one standard deviation of an estimate; 95 %: ± 1.96, of a sensitivity ± 2.04",
        ),
    ]
    return Table([("Term", ""), ("Meaning", "")], rows, "Terms", 2)
