"""The model against batches that it was not fitted to."""

import numpy as np

from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Mark, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, percent

from . import pictures
from .run import Run

DOUBT = 0.01  # tail below which a batch as a whole is not what the model expects


def validation(run: Run) -> Section:
    """Coverage of the prediction intervals, batch by batch, and every point."""
    title, short = "Model validation", "Validation"
    found = run.get("estimation.validation")
    if not found:
        text = (
            "No batch was held out of a fit: `held_out = true` of an experiment under "
            "`[[estimation.experiments]]` keeps it for this."
        )
        return Section("validation", title, short, [Missing(text)])
    level = percent(run.get("estimation.level"), 0)
    points = len(found["measured"])
    low, high = (percent(found[key], 0) for key in ("low", "high"))
    tail = finite(run.get("estimation.tail"))
    blocks: list[Block] = [
        Text(
            f"Of {points} measurements of batches held out of the fit {percent(found['coverage'])} "
            f"lie within their {level} prediction intervals ({low} to {high} as of independent "
            "points). An interval adds the measurement's error to what the fit does not know; "
            "points of one batch err together, which chi² of the batch takes into account."
        ),
        _batches(found),
        _points(run, found),
    ]
    if tail is not None:
        text = f"Of the fit itself chi² is exceeded by chance in {percent(tail)} of all cases"
        end = (
            "." if tail >= DOUBT else ": the errors of the measurements, or the model, fall short."
        )
        blocks.append(Text(text + end))
    return Section("validation", title, short, blocks)


def _batches(found) -> Table:
    rows = [
        (
            each["experiment"],
            f"{each['inside']} of {each['points']}",
            number(each["chi2"]),
            percent(each["tail"]),
            Mark(each["tail"] >= DOUBT, "as expected" if each["tail"] >= DOUBT else "differs"),
        )
        for each in found["batches"]
    ]
    head = [("Batch held out", ""), ("Inside", ""), ("Chi²", ""), ("By chance above", ""), ("", "")]
    return Table(head, rows, "Every batch as a whole", 1)


def _points(run: Run, found) -> Chart:
    """Measured less predicted over the half width of the interval: inside is -1 to 1."""
    off = np.asarray(found["measured"], float) - np.asarray(found["predicted"], float)
    share = off / np.asarray(found["half"], float)

    def paint(axes):
        pictures.residuals(axes, share)

    svg = draw("validation", "Prediction errors of the batches held out.", paint, 200)
    worst = number(float(np.abs(share).max()), 2)
    caption = (
        "Measured less predicted over the half width of the interval, in the order of the data: "
        f"inside from −1 to 1; the largest is {worst}."
    )
    return Chart(svg, caption)
