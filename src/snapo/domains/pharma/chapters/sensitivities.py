"""The sensitivity matrix as heat map in three forms, the ranking, tornados."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from snapo.report.drawing import draw
from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Block, Chart, Missing, Table, Text
from snapo.report.quantity import number, percent, with_unit
from snapo.study.chapter import Chapter, Floats
from snapo.study.study import Part, StudyRun

from ..derivatives import sensitivities
from ..derivatives.jacobian import matrix
from ..derivatives.sensitivities import Rank
from ..flowsheet.inputs import pharma_inputs
from ..flowsheet.process import PharmaProcess
from ..given import every_entry
from ..quality import batches
from ..quality.batches import AttributeLimits
from ..quality.draws import all_entries
from ..shared import MESH, SOUND, open_loop, process, sampled
from . import pictures
from .model import Statement, stated

DRAWS, LEVELS = 64, (0.05, 0.95)
SLOPES = "attribute_sensitivities.csv"  # of the attributes; a policy has a separate table


@dataclass(frozen=True, eq=False)
class SensitivityMatrix:
    """Q attributes by P parameters in three forms, as `MatrixForms`, and the parameters by rank.

    - `mode`, `reason`, `passes`: how the derivatives were computed; `values` [Q]: the values of the
      attributes.
    - `varied` [Q, V]: with respect to all numbers that differ from batch to batch, per unit of the
      computation.
    """

    mode: str
    reason: str
    passes: int
    values: Floats
    raw: Floats
    scaled: Floats
    share: Floats
    zero: Floats
    ranking: tuple[Rank, ...]
    varied: Floats


def measure(run: StudyRun) -> SensitivityMatrix:
    """The matrix, by one pass for the parameters and for all other numbers that vary."""
    complete, case = process(run), process(run).case
    entries = batches.varied(case)
    result = matrix(complete, entries=entries)
    columns = [entries.index((x.input, x.entry)) for x in case.parameters]
    forms = sensitivities.table(case, result._replace(jacobian=result.jacobian[:, columns]))
    varied = result.jacobian[:, : len(all_entries(case))]
    ranks = sensitivities.ranking(case, forms, result, sensitivities.spread(case, varied))
    return SensitivityMatrix(
        mode=result.mode, reason=result.reason, passes=result.passes, values=result.values,
        **forms._asdict(), ranking=tuple(ranks), varied=varied,
    )  # fmt: skip


def every_sensitivity(complete: PharmaProcess) -> Iterable[tuple]:
    """Rows (attribute, input, label, value, unit) with respect to all numbers of the case."""
    inputs = pharma_inputs(complete.case)
    entries = every_entry(complete.inputs)
    jacobian = matrix(complete, entries=entries, mode="adjoint").jacobian
    for attribute, row in zip(complete.case.attributes, jacobian):
        for (name, i), value in zip(entries, row.tolist()):
            unit = f"({attribute.unit})/({inputs[name].unit})"
            yield attribute.name, name, inputs[name].labels[i], value, unit


def _write(run: StudyRun) -> dict[str, str]:
    header = ("attribute", "input", "label", "value", "unit")
    run.write_csv(SLOPES, header, every_sensitivity(process(run)))
    return {}


@dataclass(frozen=True, eq=False)
class CriticalityTable:
    """[Q, P]: half the `change` of an attribute as a parameter goes from the lower to the upper end
    of its normal range, by the nominal model, in the attribute's unit.

    - `low`, `high`: its 5 % and 95 % quantiles over the variation that the case states.
    - `share`, `share_low`, `share_high`: the size of the change, as a share of the distance to the
      nearest limit at the set point; NaN without a limit, infinite on or beyond it.
    - `draws`: the draws of the variation.
    """

    change: Floats
    low: Floats
    high: Floats
    share: Floats
    share_low: Floats
    share_high: Floats
    draws: int


def criticality(process: PharmaProcess, seed: int, draws: int = DRAWS) -> CriticalityTable:
    """The criticality from the nominal batch, and from the same drawn batches, at both ends of
    every normal range."""
    case = process.case
    entries = batches.varied(case)
    here = batches.nominally(process, {})
    base = np.concatenate([here, batches.drawn(process, {}, draws, seed)])
    rows = []
    for x in case.parameters:
        column = entries.index((x.input, x.entry))
        for end in (x.normal_low, x.normal_high):
            moved = base.copy()
            moved[:, column] += end - here[0, column]
            rows.append(moved)
    values = batches.attributes(process, np.concatenate([here, *rows]))
    room = AttributeLimits.of(case).distance(values[0])[:, None]
    endpoints = values[1:].reshape(len(case.parameters), 2, 1 + draws, -1)
    half = (endpoints[:, 1] - endpoints[:, 0]).transpose(
        1, 2, 0
    ) / 2  # draws, attributes, parameters
    low, high = np.nanquantile(half[1:], LEVELS, axis=0)
    sizes = np.stack([np.abs(half[0]), *np.nanquantile(np.abs(half[1:]), LEVELS, axis=0)])
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(room > 0, sizes / room, np.where(sizes > 0, np.inf, 0.0))
    shares = np.where(AttributeLimits.of(case).any()[:, None], shares, np.nan)
    return CriticalityTable(half[0], low, high, *shares, draws=draws)


CRITICALITY = Chapter(
    "criticality", "Criticality", CriticalityTable,
    lambda run: criticality(sampled(run), open_loop(run).seed + 3), lambda run, result: [],
    needs=(MESH,), key="criticality"
)  # fmt: skip


def show(run: RunFiles, result: SensitivityMatrix) -> list[Block]:
    """The matrix over half the normal range as heat map, all forms as tables, and the ranking."""
    case, criticality = stated(run), CRITICALITY.of(run)
    return [
        Text(f"Computed in {result.mode} mode: {result.reason}."), _heat(case, result),
        _forms(case, result), _ranking(result.ranking),
        why_missing(run, CRITICALITY.name)
        if criticality is None
        else _criticality(case, criticality),
        _tornados(case, result.scaled),
    ]  # fmt: skip


def _heat(case: Statement, result: SensitivityMatrix) -> Chart:
    """Cells by their share of the margin to the limit, which makes rows comparable."""
    rows, share = case.attribute_names, result.share
    texts = [[_cell(x) for x in row] for row in share]
    depths = np.nan_to_num(share, nan=0.0, posinf=1.0, neginf=-1.0)

    def paint(axes):
        pictures.heat(axes, depths, texts, rows, case.parameter_names, np.ones(len(rows)))

    svg = draw("matrix", "Share of the margin to each limit that each parameter uses.", paint,
               60 + 28 * len(rows))  # fmt: skip
    caption = (
        "Change of an attribute over half the normal range of a parameter, as a share of the "
        "margin to its nearest limit. Orange: a higher parameter raises the attribute; blue: it "
        "lowers the attribute. A 0 is exact, because nothing connects the two."
    )
    return Chart(svg, caption)


def _cell(value: float) -> str:
    if np.isnan(value):
        return "–"
    if value == 0:
        return "0"
    return "beyond" if np.isinf(value) else percent(value, 0 if abs(value) >= 0.1 else 1)


def _forms(case: Statement, result: SensitivityMatrix) -> Table:
    rows = []
    for q, attribute in enumerate(case.attributes):
        unit = attribute.shown_unit
        for form, values, label in (
            ("per unit of the parameter", result.raw, unit),
            ("over half the normal range", result.scaled, unit),
            ("share of the margin to the limit", result.share, ""),
        ):
            cells = ["0" if x == 0 else number(x) for x in values[q]]
            rows.append((attribute.name, form, label, *cells))
    parameters = [(x.name, x.shown_unit) for x in case.parameters]
    head = [("Attribute", ""), ("Form", ""), ("Unit", ""), *parameters]
    caption = "The matrix in three forms; a 0 is exact, because nothing connects the two"
    return Table(head, rows, caption, 3, folded="The matrix in numbers")


def _ranking(ranks: tuple[Rank, ...]) -> Table | Missing:
    if not ranks:
        return Missing("Parameters were not ranked in this run.")
    rows = [
        (
            x.parameter, x.attribute or "–",
            "–" if x.outside or x.spent else percent(x.share, 1), percent(x.variance, 0),
            "attribute beyond its limit" if x.outside
            else "variation uses all of the margin" if x.spent else "",
        )
        for x in ranks
    ]  # fmt: skip
    names = ("Parameter", "Most critical for", "Share of margin used", "Share of its variance", "")
    caption = (
        "Criticality of a parameter: the largest share of the margin of any limit that half of its "
        "normal range uses. Here the margin is the distance to the limit minus two standard "
        "deviations of the batches. The last number is the share of the attribute's variance that "
        "is due to the parameter"
    )
    return Table([(name, "") for name in names], rows, caption, frozenset({0, 1, 4}))


def _criticality(case: Statement, result: CriticalityTable) -> Table:
    """A row for every parameter, a column for every attribute: the share of the margin, with an
    interval."""
    shares = np.stack([result.share, result.share_low, result.share_high], -1)
    rows = [
        (name, *(_interval(*shares[q, p]) for q in range(len(shares))))
        for p, name in enumerate(case.parameter_names)
    ]
    caption = (
        "Effect of every parameter on every attribute: half of the change as the parameter goes "
        "over its normal range, as a share of the margin to the nearest limit; in brackets the 5 % "
        f"and 95 % quantiles of this share over {number(result.draws, 0)} draws of the variation"
    )
    return Table([("Parameter", ""), *((name, "") for name in case.attribute_names)], rows, caption)


def _interval(share: float, low: float, high: float) -> str:
    if np.isnan(share):
        return "–"
    if share == 0 and high == 0:
        return "0"
    if np.isinf(share):
        return "beyond"
    return f"{percent(share, 1)} ({number(100 * low, 1)} – {number(100 * high, 1)})"


def _tornados(case: Statement, scaled: np.ndarray) -> Chart:
    count = len(case.attributes)

    def paint(*panels):
        for axes, attribute, changes in zip(panels, case.attributes, scaled):
            label = with_unit(attribute.name, attribute.shown_unit)
            pictures.tornado(axes, case.parameter_names, changes, label)

    svg = draw("tornado", "Change of every attribute over half the normal range of every "
               "parameter.", paint, 24 + 110 * count, [1.0] * count)  # fmt: skip
    caption = (
        "Change of each attribute as one parameter moves over its normal range, to first order; "
        "the dark mark is the change at the upper end of the range."
    )
    return Chart(svg, caption)


MATRIX = Chapter(
    "sensitivity matrix", "Sensitivity of quality to process parameters", SensitivityMatrix,
    measure, show, "Sensitivities", needs=(SOUND,), key="matrix"
)  # fmt: skip
ALL_SENSITIVITIES = Part("all sensitivities", _write, (SOUND,))
