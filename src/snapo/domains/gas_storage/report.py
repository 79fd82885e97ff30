"""How a storage run is told: its sections, and the picture for the README."""

from pathlib import Path

import numpy as np

from snapo.report import charts
from snapo.report.drawing import draw_alone
from snapo.report.page import Section
from snapo.report.quantity import long_date
from snapo.report.sections.proof import making
from snapo.report.theme import LIGHT
from snapo.study.chapters.bound import value_bounds
from snapo.study.domain import Report

from .chapters.certificate import CERTIFICATE
from .chapters.deltas import DELTAS, daily, month_painter
from .chapters.evidence import assumptions, history
from .chapters.headline import headline
from .chapters.position import POSITION, inventory
from .chapters.risk import risk, sliders
from .chapters.run import StorageRun
from .chapters.today import ladder
from .chapters.value import VALUES, cash_flow, ladder_bars

HEADING = {"loc": "left", "pad": 26, "color": LIGHT["ink"], "fontweight": "bold"}


def today(run: StorageRun) -> Section:
    """The decision of today, from the chapter of the store over time."""
    position = POSITION.of(run)
    return ladder(run, None if position is None else position.today)


SECTIONS = (
    headline, VALUES, value_bounds, POSITION, inventory, DELTAS, daily, risk,
        sliders, today, cash_flow,
    history, CERTIFICATE, assumptions, making,
)  # fmt: skip


def _about(run: StorageRun) -> list[tuple[str, str]]:
    pairs = []
    if run.get("valuation_date"):
        pairs.append(("Valuation date", long_date(run.get("valuation_date"))))
    if run.get("start") and run.get("end"):
        dates = f"{long_date(run.get('start'))} to {long_date(run.get('end'))}"
        pairs.append(("Contract, end not included", dates))
    if run.days:
        pairs.append(("Decision days left", f"{len(run.days):,}"))
    if run.currency:
        pairs.append(("Units", f"{run.currency}, {run.volume}"))
    return pairs


REPORT = Report("Gas storage", StorageRun, _about, SECTIONS)


def readme_picture(folder: Path) -> str:
    """A picture of a result as SVG text that stands alone: value ladder and monthly deltas.

    Raises `ValueError` where the run lacks either.
    """
    run = StorageRun.read(Path(folder))
    values, deltas = VALUES.of(run), DELTAS.of(run)
    months = deltas.deltas_monthly if deltas else ()
    if (
        values is None
        or not values.value_of
        or not any(np.isfinite(x.undiscounted) for x in months)
    ):
        raise ValueError("the run has no `value_ladder` or no `deltas_monthly`.")

    def paint(left, right):
        charts.ladder(left, ladder_bars(run, values.value_of))
        left.set_title("Value of the contract", **HEADING)
        month_painter(run, months)(right)
        right.set_title(f"Delta by delivery month, {run.volume}", **HEADING)

    title = f"{run.get('title', 'Gas storage')}: value ladder and deltas by delivery month"
    return draw_alone(title, paint, (900.0, 280.0), (1.0, 1.25))
