"""The distribution of the total of every output over the paths of the evaluation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Text
from snapo.report.quantity import number, quantity, readable, unit_words, with_unit
from snapo.report.rows import Column, table
from snapo.solver import statistics

from ..chapter import Chapter, Floats, Number, floats
from ..study import StudyRun

BINS = 60
QUANTILES = {"p01": 0.01, "p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95,
             "p99": 0.99}  # fmt: skip
TAIL = 0.05  # the mean of this worst (smallest) share is reported as well
PICTURES = 4  # of outputs; the table has all of them
COLUMNS = (
    Column("Mean", "mean"), Column("Std deviation", "standard_deviation"),
    Column("Worst 5 %, mean", "tail_mean"), *(
        Column(header, lambda total, name=name: total.quantiles.get(name))
        for name, header in [("p01", "1 %"), ("p05", "5 %"), ("p50", "Median"), ("p95", "95 %"),
                             ("p99", "99 %")]
    ),
)  # fmt: skip


@dataclass(frozen=True)
class OutputTotal:
    """The distribution of an output's total over a path: moments, quantiles and a histogram, in its
    `unit`.

    - `paths`: the number of paths with a finite total; if there are none, the other numbers are NaN
      or empty.
    - `tail_mean`: the mean of the smallest 5 % of the totals.
    - `quantiles`, `quantile_errors`: {"p05": number}; errors are standard errors.
    - `edges` [B + 1], `counts` [B]: the outermost bins include the paths outside of the edges.
    """

    name: str = ""
    unit: str = ""
    paths: int = 0
    mean: Number = np.nan
    standard_deviation: Number = np.nan
    standard_error: Number = np.nan
    tail_mean: Number = np.nan
    tail_error: Number = np.nan
    quantiles: dict[str, Number] = field(default_factory=dict)
    quantile_errors: dict[str, Number] = field(default_factory=dict)
    edges: Floats = floats()
    counts: Floats = floats()


@dataclass(frozen=True)
class OutputTotals:
    """The totals of all outputs, in the order of the simulator."""

    distribution: tuple[OutputTotal, ...]


def measure(run: StudyRun) -> OutputTotals:
    """Measures the totals in the evaluation of the trained policy; units are taken from the study's
    `about`."""
    units: Mapping[str, str] = run.study.about.get("units", {})
    paths = np.arange(run.solution.paths["evaluate"])
    groups = run.setup.problem.sources.evaluation.groups(paths)
    totals = run.solution.totals.items()
    return OutputTotals(
        tuple(
            distributed(np.asarray(total), groups, name, units.get(name, ""))
            for name, total in totals
        )
    )


def distributed(
    total: np.ndarray, groups: np.ndarray, name: str = "", unit: str = ""
) -> OutputTotal:
    """The distribution of the finite numbers among totals [paths]; `groups` [paths]: the groups of
    dependent paths."""
    finite = np.isfinite(total)
    total, groups = total[finite], groups[finite]
    if not total.size:
        return OutputTotal(name, unit)
    # The outermost paths would only stretch the histogram.
    low, high = np.quantile(total, [0.0005, 0.9995])
    edges = np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])
    counts, _ = np.histogram(np.clip(total, edges[0], edges[-1]), edges)
    tail = np.sort(total)[: max(1, round(TAIL * total.size))]
    return OutputTotal(
        name,
        unit,
        paths=total.size,
        mean=total.mean(),
        standard_deviation=total.std(ddof=1) if total.size > 1 else 0.0,
        standard_error=statistics.mean(total, groups).standard_error,
        tail_mean=tail.mean(),
        tail_error=statistics.tail(total, 1 - TAIL, groups).standard_error,
        quantiles=dict(zip(QUANTILES, np.quantile(total, list(QUANTILES.values())))),
        quantile_errors={
            name: statistics.quantile(total, level, groups).standard_error
            for name, level in QUANTILES.items()
        },
        edges=edges,
        counts=counts,
    )


def show(run: RunFiles, result: OutputTotals) -> list[Block]:
    """Shows a histogram for each of the first outputs, and one table for all outputs."""
    first = run.get("objective_output")
    totals = [total for total in result.distribution if total.paths and run.title_of(total.name)]
    totals.sort(key=lambda total: total.name != first)
    varying = [total for total in totals if total.name == first or total.standard_deviation]
    pictures = [
        histogram(f"distribution-{i}", total, run.title_of(total.name))
        for i, total in enumerate(varying[:PICTURES])
    ]
    head = (
        Column("Output", lambda total: run.title_of(total.name)),
        Column("Unit", lambda total: unit_words(total.unit)),
    )
    blocks = [*pictures, table(totals, (*head, *COLUMNS), "Totals of a path", by_row=True)]
    return [*blocks, *_plain_mean(run, totals, str(first))]


CLOSE = 0.1  # of the value: further apart, the total is another quantity, such as a sum over weeks
PLAIN = (
    "The means here are plain means over the paths. The value on the first screen is from the "
    "same paths, but with control variates, which remove a part of the noise."
)


def _plain_mean(run: RunFiles, totals: Sequence[OutputTotal], first: str) -> list[Text]:
    """A sentence for runs in which the mean of the objective's output is not the value."""
    value, objective = run.result.value, str(run.get("objective", ""))
    means = [total.mean for total in totals if total.name == first]
    if value is None or not means or not objective.startswith("mean"):
        return []
    differs = 1e-9 * abs(value) < abs(means[0] - value) < CLOSE * abs(value)
    return [Text(PLAIN, caveat=True)] if differs else []


def histogram(anchor: str, total: OutputTotal, title: str = "") -> Chart:
    """The histogram of a total with its mean and the 5 % and 95 % quantiles."""
    marks = [("mean", total.mean), ("5 %", total.quantiles.get("p05"))]
    marks.append(("95 %", total.quantiles.get("p95")))
    drawn = [(text, x) for text, x in marks if x is not None and np.isfinite(x)]
    name, paths = title or readable(total.name), number(total.paths, 0)
    mean = quantity(total.mean, total.unit)
    alt = f"Histogram of {name} over {paths} paths; its mean is {mean}."
    label = with_unit(name, total.unit)
    svg = draw(
        anchor,
        alt,
        lambda axes: charts.histogram(axes, total.edges, total.counts, drawn, label),
        220,
    )
    caption = (
        f"{name}: the total of a path, for {paths} paths under the exact rules. The outermost "
        f"bins include the paths outside of the edges."
    )
    return Chart(svg, caption)


DISTRIBUTION = Chapter("distribution", "Distribution of the totals", OutputTotals, measure, show)
