"""The first and the last section: the state of a run with its checks, and how it was made."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version

from snapo.report.evidence import check_marks, spent
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Headline, Mark, Missing, Section, Table, Text
from snapo.report.quantity import (
    PLUS_MINUS,
    finite,
    number,
    percent,
    plus_minus,
    quantity,
    seconds,
)
from snapo.solver.provenance import versions
from snapo.study.chapter import Chapter
from snapo.study.domain import GOOD
from snapo.study.run_folder import case_files
from snapo.study.study import StudyRun

from ..flowsheet.case import PharmaCase
from ..quality.estimation import MISFIT, ParameterFit
from ..shared import open_loop
from .attribution import ATTRIBUTION
from .batch import ONE_BATCH, BatchResult
from .capability import CAPABILITY, STATISTICS_MESH
from .closed_loop import CLOSED_LOOP
from .design_space import SPACE
from .estimation import ESTIMATION
from .model import Statement, stated
from .optimum import OPTIMUM
from .ranges import RANGES
from .sensitivities import MATRIX
from .verification import BALANCES, CONVERGENCE, DIFFERENCES, closed, largest_gap

AGREED = 1e-10  # relative gap of paths against the matrix
LOST = 1e-3  # share of batches without a finite result from which a run is not in order


def checks(run: StudyRun | RunFiles) -> list[tuple[str, bool, str]]:
    """Rows (name of the check, whether it passed, where its error is largest, in brackets)."""
    rows = []
    if balances := BALANCES.of(run):
        off = [x for x in balances if not closed(x)]
        rows.append(("balances", not off, _where(*((x.unit, x.quantity) for x in off[:1]))))
    if convergence := CONVERGENCE.of(run):
        row = max(convergence.rows, key=largest_gap, default=None)
        where = _where((row.attribute, row.parameter)) if row else ""
        rows.append(("convergence in time", convergence.passed, where))
        if convergence.cells:
            worst = max(convergence.cells, key=lambda x: _size(x.margins))
            valid = all(x.passed for x in convergence.cells)
            rows.append(("twice as many cells", valid, _where((worst.attribute,))))
    if points := DIFFERENCES.of(run):
        off = [x for x in points if not x.passed]
        where = _where(*((x.attribute, x.parameter, x.point) for x in off[:1]))
        rows.append(("adjoint against differences", not off, where))
    if attribution := ATTRIBUTION.of(run):
        rows.append(("paths add up", attribution.closure <= AGREED, ""))
    return rows


def _size(value: float) -> float:
    """The value for a comparison: NaN counts as infinite."""
    return math.inf if math.isnan(value) else value


def _where(*names: Iterable[str]) -> str:
    text = ", ".join(filter(None, (name for row in names for name in row)))
    return f" ({text})" if text else ""


def status(run: StudyRun | RunFiles) -> str:
    """The first problem of the run in a sentence, or "ok"."""
    batch, fit, recipe = ONE_BATCH.of(run), ESTIMATION.of(run), OPTIMUM.of(run)
    if batch is not None and batch.status != "ok":
        return batch.status
    missing = [name for name, x in batch.attributes.items() if math.isnan(x)] if batch else []
    if missing:
        return f"{missing[0]} is not a number"
    if fit is not None and (ambiguity := reservations(fit)):
        return ambiguity
    if recipe is not None and not recipe.converged:
        return f"the best recipe did not converge: {recipe.message}"
    failed = [name + where for name, valid, where in checks(run) if not valid]
    if failed:
        return f"a check fails: {', '.join(failed)}"
    batches = CAPABILITY.of(run)
    lost = batches.failed / batches.batches if batches and batches.batches else 0.0
    return f"{100 * lost:.2g} % of the batches gave no finite result" if lost > LOST else "ok"


def reservations(fit: ParameterFit) -> str:
    """The reason why a fit is not reliable, or ""."""
    if not fit.converged:
        return f"the fit did not converge: {fit.message}"
    if not fit.tail < MISFIT:
        return ""
    return (
        f"the fit does not describe its data: chi² {fit.chi2:.4g} at {fit.freedom} degrees of "
        f"freedom, which a correct model exceeds with probability {fit.tail:.1g}"
    )


def headline(run: RunFiles) -> Section:
    """Probability of all limits, and the table of attributes at the set point."""
    title = "Quality at the set point"
    value, error = run.result.value, run.result.standard_error
    blocks: list[Block] = []
    if value is None:
        state = run.result.status or "unknown"
        blocks.append(Missing(f"There is no probability in this run (status: {state})."))
    else:
        blocks.append(
            Headline(
                label="Probability that a batch meets all limits", value=percent(value),
                error=plus_minus(None if error is None else 100 * error, 1), note=_note(run),
                marks=marks(run),
            )
        )  # fmt: skip
    if facts := _facts(run):
        blocks.append(Facts(facts))
    batch = ONE_BATCH.of(run)
    available = batch is not None and batch.attributes
    blocks.append(
        _table(stated(run), batch) if batch and available else why_missing(run, ONE_BATCH.name)
    )
    return Section("headline", title, "", blocks)


def _note(run: RunFiles) -> str:
    if run.result.verdict:
        return f"{run.result.verdict} {PLUS_MINUS}, in percentage points."
    who = "With the trained policy" if CLOSED_LOOP.of(run) else "With the recipe of the case"
    return (
        f"{who}, over the batch-to-batch variation that the case states; {PLUS_MINUS}, in "
        "percentage points."
    )


def marks(run: RunFiles) -> list[Mark]:
    """Verdicts on the numbers, then on the process; a bad status comes first."""
    rows, state = checks(run), run.result.status or "ok"
    verdicts = check_marks([(name, valid) for name, valid, _ in rows], "numerical checks")
    if state not in GOOD and all(mark.good for mark in verdicts):
        verdicts = [Mark(False, state)]
    return [*verdicts, *(Mark(False, text) for text in _against(run))]


def _against(run: RunFiles) -> list[str]:
    """All results that speak against the process, even if the numbers are accurate."""
    rows, batch, recipe = RANGES.of(run) or (), ONE_BATCH.of(run), OPTIMUM.of(run)
    contains = batch.holds if batch else ()
    broken = [name for name, valid in zip(stated(run).attribute_names, contains) if not valid]
    outside = [x.parameter for x in rows if not x.probable.holds_normal]
    unsure = [x.parameter for x in rows if x.probable.holds_normal and not x.probable.sure_normal]
    verdicts = [
        f"{text}: {', '.join(names)}"
        for text, names in (
            ("at the set point a limit is broken", broken),
            ("normal ranges not inside the proven ranges", outside),
            ("normal ranges inside the proven ranges, but not with 95 % confidence", unsure),
        )
        if names
    ]
    if recipe is not None:
        before, after = recipe.chance
        if after.probability < before.probability - 3 * after.error:
            pair = f"{percent(after.probability)} instead of {percent(before.probability)}"
            text = f"the optimised recipe meets all limits less often, {pair}: use a reserve"
            verdicts.append(text)
    return verdicts


def _facts(run: RunFiles) -> list[tuple[str, str, str]]:
    facts, matrix, space = [], MATRIX.of(run), SPACE.of(run)
    batches, loop = CAPABILITY.of(run), CLOSED_LOOP.of(run)
    if matrix and matrix.ranking and matrix.ranking[0].attribute:
        first = matrix.ranking[0]
        share, attribute = percent(first.share, 0), first.attribute
        note = (
            f"its normal range uses {share} of the margin of {attribute} that the variation "
            "of the batches leaves"
        )
        if first.outside:
            note = f"{attribute} is beyond its limit"
        elif first.spent:
            note = f"the variation of the batches uses all of the margin of {attribute}"
        facts.append(("Most critical parameter", first.parameter, note))
    if space and space.box:
        volume = percent(space.box.volume, 0)
        facts.append(("Largest box inside", volume, "of the studied range"))
    if batches and finite(batches.joint) is not None:
        note = f"of {number(batches.batches, 0)} simulated batches"
        facts.append(("Out of specification, original recipe", percent(batches.joint), note))
    if loop:
        error = plus_minus(100 * loop.baseline_error, 1)
        facts.append(("All limits, best fixed recipe", percent(loop.baseline), error))
    return facts


def _table(case: Statement, batch: BatchResult) -> Table:
    rows = []
    for attribute, valid, room in zip(case.attributes, batch.holds, batch.distance):
        unit = "" if attribute.unit == "1" else attribute.unit
        rows.append(
            (
                attribute.name, attribute.limits, attribute.citation or "–",
                Mark(valid, "holds" if valid else "broken") if attribute.limited else "–",
                quantity(batch.attributes.get(attribute.name), unit),
                quantity(room, unit) if attribute.limited else "–",
            )
        )  # fmt: skip
    names = ("Attribute", "Limit", "Source", "", "Value", "Margin to the limit")
    caption = "Quality attributes of one batch at the set point"
    return Table([(name, "") for name in names], rows, caption, 4)


@dataclass(frozen=True)
class Making:
    """How a run's numbers were computed, in addition to its statement: remarks, versions,
    hashes."""

    notes: tuple[str, ...] = ()
    libraries: dict[str, str] | None = None
    hashes: dict[str, str] | None = None
    versions: dict[str, str] | None = None
    seed: int | None = None

    @classmethod
    def of(cls, case: PharmaCase) -> "Making":
        """The information that is available before the run; a training records versions and seed
        itself."""
        files = {file.name: file.read_bytes() for file in case_files(case.file.parent)}
        alone = case.control is None
        return cls(
            notes=tuple(case.notes),
            libraries={name: _version(name) for name in ("diffrax", "pint", "scipy")},
            hashes={name: sha256(content).hexdigest() for name, content in files.items()},
            versions=versions() if alone else None,
            seed=case.training.seed if alone else None,
        )


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"


def show(run: RunFiles, result: Making) -> list[Block]:
    """Assumptions of the model, remarks, and the versions behind the numbers."""
    case = stated(run)
    blocks: list[Block] = [Text(text) for text in case.assumptions]
    if not blocks:
        blocks.append(Missing("The assumptions are not in this run."))
    blocks += [Text(note, caveat=True) for note in (*result.notes, *_remarks(run, case))]
    times = spent(run)
    if times.get("total") is not None:
        blocks.append(Facts([("Whole study", seconds(times["total"]), "wall clock")]))
    rows = [(name.capitalize(), seconds(x)) for name, x in times.items() if name != "total"]
    if rows:
        blocks.append(Table([("Part", ""), ("Time", "")], rows, folded="Time of every part"))
    return [*blocks, _made_with(run, case, result)]


def _remarks(run: RunFiles, case: Statement) -> list[str]:
    """Remarks from the run itself: parts that failed, and a coarser mesh."""
    texts = [f"{name} failed: {x.note}" for name, x in run.parts.items() if x.note]
    mesh, steps = STATISTICS_MESH.of(run), _steps(run, case)
    if mesh is not None and mesh.steps != steps:
        texts.append(
            f"Statistics of many batches use {mesh.steps} steps per piece, which moves no "
            f"attribute by more than {mesh.gap:.1g} of its margin."
        )
    return texts


def _steps(run: RunFiles, case: Statement) -> int | None:
    """The steps per piece of the computed batch, or those of the case without a batch."""
    batch = ONE_BATCH.of(run)
    if batch is not None:
        return batch.steps
    return case.numerics.steps if case.numerics else None


def _made_with(run: RunFiles, case: Statement, made: Making) -> Table | Missing:
    rows = [] if made.seed is None else [("Seed", number(made.seed, 0))]
    batch, numerics = ONE_BATCH.of(run), case.numerics
    if numerics is not None:
        rows.append(("Integration", f"{numerics.method}, {_steps(run, case)} steps per piece, "
                     f"tolerance {numerics.tolerance:g}"))  # fmt: skip
    for unit, error in (batch.errors if batch else {}).items():
        text = f"stiff: Rosenbrock steps (Rodas5P), error of a step at most {error:.1g}"
        rows.append((f"Integration of {unit}", text))
    names = (made.versions or {}) | (made.libraries or {})
    if names:
        rows.append(("Versions", ", ".join(f"{name} {x}" for name, x in names.items())))
    rows += [(f"SHA-256 of {name}", text) for name, text in (made.hashes or {}).items()]
    if not rows:
        return Missing("This run has no record of seed, versions and hashes.")
    return Table([], rows, "How to reproduce these numbers", 2)


MAKING = Chapter(
    "assumptions", "Assumptions, versions and hashes", Making,
    lambda run: Making.of(open_loop(run).case), show, "Assumptions"
)  # fmt: skip
