"""Why to believe the number, and how to get it again."""

from .. import evidence
from ..folder import Folder
from ..page import Block, Facts, Missing, Section, Table, Text
from ..quantity import finite, number, seconds
from .distribution import words
from .lacking import lacking


def history(run: Folder) -> Section:
    """The objective and the gradient norm over the steps of training."""
    return evidence.history(run, run.unit)


def certificate(run: Folder) -> Section:
    """Every test that this very run was put to."""
    title, short = "Certificate: why to believe this number", "Certificate"
    if not run.get("certificate"):
        return Section("certificate", title, short, [lacking(run, "certificate")])
    step = str(run.get("step", "step")).capitalize()
    blocks: list[Block] = [evidence.bump_table(run, run.unit, words)]
    if run.get("certificate.feasibility"):
        blocks.append(evidence.limit_table(run, "", step, lambda t: number(finite(t), 0)))
    else:
        text = "The simulator declares no limits: its method `slack` names none."
        blocks.append(Missing(text))
    return Section("certificate", title, short, blocks, break_before=True)


def making(run: Folder) -> Section:
    """Notes, the state of every part, times, engine, seed and versions."""
    blocks: list[Block] = [Text(str(note)) for note in run.get("notes", [])]
    blocks += [_parts(run), *_times(run), evidence.made_with(run)]
    return Section("making", "Parts, times and versions", "Versions", blocks)


def _times(run: Folder) -> list[Facts]:
    """The stages of the training and the total; the parts have theirs in their table."""
    found = [
        (name.capitalize(), seconds(each), evidence.TOTAL if name == "total" else "wall clock")
        for name, each in evidence.spent(run).items()
        if name not in run.parts
    ]
    return [Facts(found)] if found else []


def _parts(run: Folder) -> Table:
    rows = [
        (
            words(name),
            evidence.verdict(state.get("state") == "done", "done", str(state.get("state"))),
            str(state.get("note") or ""),
            seconds(state.get("seconds")),
        )
        for name, state in run.parts.items()
    ]
    head = [("Part", ""), ("", ""), ("Note", ""), ("Time", "")]
    return Table(head, rows, "Parts of this run", 3)
