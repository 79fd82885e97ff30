"""How a storage run is told: its sections, and the picture for the README."""

from pathlib import Path

import numpy as np

from snapo.report import charts
from snapo.report.drawing import draw_alone
from snapo.report.quantity import array, decimals, finite, long_date
from snapo.report.sections.bound import bound
from snapo.report.sections.proof import making
from snapo.report.theme import LIGHT
from snapo.study.domain import Report

from .results.certificate import CERTIFICATE
from .sections import evidence, headline, position, risk, today, value
from .sections.run import Run

HEADING = {"loc": "left", "pad": 26, "color": LIGHT["ink"], "fontweight": "bold"}
SECTIONS = (
    headline.headline,
    value.value_ladder,
    bound,
    position.curve,
    position.inventory,
    position.monthly,
    position.daily,
    risk.risk,
    risk.sliders,
    today.today,
    value.cash_flow,
    evidence.history,
    CERTIFICATE,
    evidence.assumptions,
    making,
)


def _about(run: Run) -> list[tuple[str, str]]:
    found = []
    if run.get("valuation_date"):
        found.append(("Valuation date", long_date(run.get("valuation_date"))))
    if run.get("start") and run.get("end"):
        dates = f"{long_date(run.get('start'))} to {long_date(run.get('end'))}"
        found.append(("Contract, end not included", dates))
    if run.days:
        found.append(("Decision days left", f"{len(run.days):,}"))
    if run.currency:
        found.append(("Units", f"{run.currency}, {run.volume}"))
    return found


REPORT = Report("Gas storage", Run, _about, SECTIONS)


def readme_picture(folder: Path) -> str:
    """A picture of a result as SVG text that stands alone: value ladder and monthly deltas.

    Raises `ValueError` where the run lacks either.
    """
    run = Run.read(Path(folder))
    ladder = [each for each in run.get("value_ladder", []) if finite(each.get("value")) is not None]
    months = run.get("deltas_monthly", [])
    volumes = array([each.get("undiscounted") for each in months])
    if not ladder or volumes is None:
        raise ValueError("the run has no `value_ladder` or no `deltas_monthly`.")
    places = decimals([each["value"] for each in ladder])
    main = finite(run.result.get("value"))
    rungs = [
        charts.Rung(
            str(each["name"]),
            float(each["value"]),
            run.worth(each["value"], each.get("standard_error"), places),
            finite(each.get("standard_error")),
            finite(each["value"]) == main,
        )
        for each in ladder
    ]

    def paint(left, right):
        charts.ladder(left, rungs)
        left.set_title("Value of the contract", **HEADING)
        position.month_painter(run, months, np.asarray(volumes))(right)
        right.set_title(f"Delta by delivery month, {run.volume}", **HEADING)

    title = f"{run.get('title', 'Gas storage')}: value ladder and deltas by delivery month"
    return draw_alone(title, paint, (900.0, 280.0), (1.0, 1.25))
