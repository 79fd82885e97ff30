"""Capability: how often batches meet their limits, and the sources of their spread."""

from dataclasses import dataclass

import numpy as np

from snapo.case.error import counted
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Missing, Table, Text
from snapo.report.quantity import finite, number, percent, plus_minus, with_unit
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..derivatives.sensitivities import Spread, spread
from ..quality.capability import Capability, capability
from ..quality.sampling import sampler
from ..shared import MESH, SOUND, open_loop, sampled
from .model import stated
from .sensitivities import MATRIX

BATCHES = 4096  # at most
UNKNOWN = "Sources of variation were not computed."
NOTHING = "Nothing differs from batch to batch, so there is no spread."


@dataclass(frozen=True)
class StatisticsMesh:
    """`steps` per piece of a profile for statistics; they change no attribute by more than `gap`
    margins."""

    steps: int
    gap: Number


def choose_mesh(run: StudyRun) -> StatisticsMesh:
    """The mesh for statistics, and the process on this mesh for the following parts."""
    loop = open_loop(run)
    loop.coarse, entries = sampler(loop.process)
    return StatisticsMesh(**entries)


STATISTICS_MESH = Chapter(
    MESH, "Mesh of statistics", StatisticsMesh, choose_mesh, lambda run, result: [],
    needs=(SOUND,), key="sampling"
)  # fmt: skip


def measure(run: StudyRun) -> Capability:
    """Spread, Cpk and shares out of specification, over fresh batches."""
    complete = sampled(run)
    count = min(complete.case.evaluation.paths, BATCHES)
    return capability(complete, count, open_loop(run).seed + 1)


def measure_spread(run: StudyRun) -> Spread:
    """The sources of the spread, to first order, for comparison with the drawn batches."""
    available = MATRIX.of(run)
    assert available is not None
    return spread(open_loop(run).case, available.varied)


def show(run: RunFiles, result: Capability) -> list[Block]:
    """Spread, Cpk and out-of-specification rates, and the contribution of each source."""
    sources, attributes = SPREAD.of(run), stated(run).attributes
    linear = [None] * len(attributes) if sources is None else sources.total
    rows = [
        (
            with_unit(attribute.name, attribute.shown_unit), number(result.mean[q]),
            number(result.deviation[q]), number(linear[q]), _cpk(result.cpk_batches[q]),
            _cpk(result.cpk_low[q], result.cpk_high[q]), _cpk(result.cpk[q]),
            number(result.sigmas[q], 2), percent(result.outside[q], 2),
            plus_minus(100 * result.error[q], 2),
            " – ".join(map(number, result.quantiles[q][[0, 2]])),
        )
        for q, attribute in enumerate(attributes)
    ]  # fmt: skip
    names = ("Attribute", "Mean", "Deviation", "to first order", "Cpk, batch to batch",
             "over uncertain numbers", "Cpk, all together", "Sigmas to the limit", "Out of limits",
             "", "1–99 %")  # fmt: skip
    caption = (
        f"Of {number(result.batches, 0)} simulated batches at the set point, "
        f"{percent(result.joint)} {plus_minus(100 * result.joint_error, 1)} break a limit. “Cpk, "
        "batch to batch” is the capability if only the numbers that differ between batches vary "
        "and the model's numbers have their nominal values; the next column is its 5 to 95 % "
        "range over the uncertain numbers. “Cpk, all together” includes both kinds of variation. "
        "Cpk assumes normally distributed attributes; the share out of limits is counted. If the "
        "standard deviation to first order differs from the simulated one, the process is not "
        "linear over its variation."
    )
    blocks: list[Block] = [Table([(name, "") for name in names], rows, caption)]
    if result.failed > 0:
        blocks.append(Text(f"{counted(result.failed, 'batch')} gave no finite result."))
    if sources is None or not sources.sources:
        return [*blocks, Missing(UNKNOWN if sources is None else NOTHING)]
    return [*blocks, _sources(run, sources)]


def _cpk(*endpoints: float | None) -> str:
    """The index with two decimals, or without decimals if it or an end of its interval is 100 or
    more."""
    digits = 2 if all(abs(finite(x) or 0.0) < 100 for x in endpoints) else 0
    return " – ".join(number(x, digits) for x in endpoints)


def _sources(run: RunFiles, result: Spread) -> Table:
    parts = result.part
    share = np.divide(parts**2, (parts**2).sum(1, keepdims=True), out=np.zeros_like(parts),
                      where=parts.any(1, keepdims=True))  # fmt: skip
    rows = [
        (source, *(percent(x, 0) if x else "0" for x in share[:, v]))
        for v, source in enumerate(result.sources)
    ]
    head = [("Source", ""), *((name, "") for name in stated(run).attribute_names)]
    return Table(head, rows, "Share of each source in the variance of an attribute, to first order")


CAPABILITY = Chapter(
    "capability", "Capability and sources of variation", Capability, measure, show, "Capability",
    needs=(MESH,), key="capability"
)  # fmt: skip
SPREAD = Chapter(
    "spread", "Sources of variation", Spread, measure_spread, lambda run, result: [],
    needs=(MATRIX.name,), key="spread"
)  # fmt: skip
