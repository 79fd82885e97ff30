"""What moves what: the matrix as heat map in three forms, tornados, attribution by path."""

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section, Table, Text
from snapo.report.quantity import number, percent, with_unit

from . import pictures
from .run import Run


def sensitivity(run: Run) -> Section:
    """The matrix over half the normal range as heat map, all forms as tables, and the ranking."""
    title, short = "Sensitivity of quality to process parameters", "Sensitivities"
    raw, scaled, share = (run.table(f"matrix.{key}") for key in ("raw", "scaled", "share"))
    if raw is None or scaled is None or share is None:
        return Section("sensitivity", title, short, [Missing("This run has no matrix.")])
    blocks: list[Block] = [
        Text(f"Computed in {run.get('matrix.mode')} mode: {run.get('matrix.reason')}."),
        _heat(run, scaled, share),
        _forms(run, raw, scaled, share),
        _ranking(run),
        _criticality(run),
        _tornados(run, scaled),
    ]
    return Section("sensitivity", title, short, blocks)


def _heat(run: Run, scaled: np.ndarray, share: np.ndarray) -> Chart:
    """Cells by their share of the room to the limit, which makes rows comparable."""
    rows, columns = run.names
    texts = [[_cell(x) for x in row] for row in share]
    known = np.nan_to_num(share, nan=0.0, posinf=1.0, neginf=-1.0)

    def paint(axes):
        pictures.heat(axes, known, texts, rows, columns, np.ones(len(rows)))

    svg = draw("matrix", "Share of the room to each limit that each parameter uses.", paint,
               60 + 28 * len(rows))  # fmt: skip
    caption = (
        "Change of an attribute over half the normal range of a parameter, as a share of the room "
        "to its nearest limit. Orange raises the attribute, blue lowers it; 0 is exact: nothing "
        "connects the two."
    )
    return Chart(svg, caption)


def _cell(value: float) -> str:
    if np.isnan(value):
        return "–"
    if value == 0:
        return "0"
    return "beyond" if np.isinf(value) else percent(value, 0 if abs(value) >= 0.1 else 1)


def _forms(run: Run, raw, scaled, share) -> Table:
    names, parameters = run.names
    rows = []
    for q, name in enumerate(names):
        unit = run.attributes[q]["unit"]
        for form, values, label in (
            ("per unit of the parameter", raw, unit),
            ("over half the normal range", scaled, unit),
            ("share of the room to the limit", share, ""),
        ):
            cells = ["0" if x == 0 else number(x) for x in values[q]]
            rows.append((name, form, label, *cells))
    units = [each["unit"] for each in run.parameters]
    head = [("Attribute", ""), ("Form", ""), ("Unit", ""), *zip(parameters, units)]
    caption = "The matrix in three forms; a plain 0 is a structural zero"
    return Table(head, rows, caption, 3, folded="The matrix in numbers")


def _ranking(run: Run) -> Table | Missing:
    ranks = run.get("matrix.ranking", [])
    if not ranks:
        return Missing("Parameters were not ranked in this run.")
    rows = [
        (
            each["parameter"],
            each["attribute"] or "–",
            "–" if each["outside"] or each["spent"] else percent(each["share"], 1),
            percent(each["variance"], 0),
            _why_none(each),
        )
        for each in ranks
    ]
    names = ("Parameter", "Most critical for", "Share of the room used", "Of its variance", "")
    caption = (
        "Criticality: the largest share of any limit's room that half the normal range uses; room "
        "is the distance to the limit less two standard deviations of the batches. Last, how much "
        "of that attribute's variance the parameter causes"
    )
    return Table([(name, "") for name in names], rows, caption, frozenset({0, 1, 4}))


def _criticality(run: Run) -> Table | Missing:
    """Every parameter by every attribute: the share of its room, with an interval."""
    found = {key: run.table(f"criticality.{key}") for key in ("share", "share_low", "share_high")}
    share, low, high = found.values()
    if share is None or low is None or high is None:
        return Missing(f"There is no table of criticality: {run.why_not('criticality')}.")
    names, parameters = run.names
    rows = []
    for p, parameter in enumerate(parameters):
        cells = (_interval(*(each[q, p] for each in (share, low, high))) for q in range(len(names)))
        rows.append((parameter, *cells))
    caption = (
        "Which parameter moves which attribute: half the change as the parameter goes over its "
        "normal range, as a share of the room to the nearest limit; in brackets 5 to 95 % of it "
        f"over {number(run.get('criticality.draws'), 0)} draws of the variation"
    )
    return Table([("Parameter", ""), *((name, "") for name in names)], rows, caption)


def _interval(share: float, low: float, high: float) -> str:
    if np.isnan(share):
        return "–"
    if share == 0 and high == 0:
        return "0"
    if np.isinf(share):
        return "beyond"
    return f"{percent(share, 1)} ({number(100 * low, 1)} – {number(100 * high, 1)})"


def _why_none(rank: dict) -> str:
    """Why the share of the room has no meaning; nothing where it has one."""
    if rank["outside"]:
        return "attribute beyond its limit"
    return "variation alone takes the room" if rank["spent"] else ""


def _tornados(run: Run, scaled: np.ndarray) -> Chart:
    names, parameters = run.names
    heights = [1.0] * len(names)

    def paint(*axes):
        for q, each in enumerate(axes):
            unit = run.attributes[q]["unit"]
            pictures.tornado(each, parameters, scaled[q], with_unit(names[q], unit))

    svg = draw("tornado", "Change of every attribute over half the normal range of every "
               "parameter.", paint, 24 + 110 * len(names), heights)  # fmt: skip
    caption = (
        "Change of each attribute as one parameter moves over its normal range, to first order; "
        "the dark mark is the upper end of the parameter's range."
    )
    return Chart(svg, caption)


def attribution(run: Run) -> Section:
    """Every sensitivity by the way that it takes through the flowsheet."""
    title = "Attribution by unit and path"
    paths = run.get("attribution.paths")
    if not paths:
        return Section("attribution", title, "Attribution", [Missing("There is no attribution.")])
    blocks: list[Block] = [_by_unit(run)]
    rows = [
        (each["attribute"], each["parameter"], " → ".join(each["units"]), number(each["value"]))
        for each in paths
    ]
    head = [("Attribute", ""), ("Parameter", ""), ("Path", ""), ("Contribution", "per unit")]
    blocks.append(Table(head, rows, "Contributions add up to the matrix", 3, folded="Every path"))
    return Section("attribution", title, "Attribution", blocks)


def _by_unit(run: Run) -> Table:
    entries = run.get("attribution.by_unit", [])
    names, _ = run.names
    units = list(dict.fromkeys(each["unit"] for each in entries))
    value = {(each["unit"], each["attribute"]): each["value"] for each in entries}
    rows = []
    for q, name in enumerate(names):
        cells = [number(value.get((unit, name), 0.0)) for unit in units]
        rows.append((with_unit(name, run.attributes[q]["unit"]), *cells))
    head = [("Attribute", ""), *((unit, "") for unit in units)]
    caption = (
        "Which unit's parameters move which attribute: root of the summed squares over half their "
        "normal ranges"
    )
    return Table(head, rows, caption)
