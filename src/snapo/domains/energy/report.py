"""The report of an energy contract."""

from snapo.report.evidence import history, making
from snapo.report.folder import RunFiles
from snapo.report.quantity import long_date, number
from snapo.study.chapters.bound import value_bounds
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.headline import headline
from snapo.study.chapters.ladder import METHODS
from snapo.study.chapters.profile import profile
from snapo.study.chapters.sensitivities import sensitivities
from snapo.study.domain import Report

from ..gas_storage.chapters.gamma import GAMMA
from ..gas_storage.chapters.products import PRODUCT_DELTAS
from ..gas_storage.chapters.vega import VEGA
from .chapters.values import VALUES

OVER_TIME = profile()
SECTIONS = (
    headline, VALUES, METHODS, value_bounds, OVER_TIME, sensitivities, PRODUCT_DELTAS, VEGA, GAMMA,
    DISTRIBUTION, history, CERTIFICATE, making,
)  # fmt: skip
MENU = {
    "Value": VALUES,
    "Over time": OVER_TIME,
    "Sensitivities": sensitivities,
    "Totals": DISTRIBUTION,
    "Checks": history,
}


def _about(run: RunFiles) -> list[tuple[str, str]]:
    dates = [("Valuation date", run.get("valuation_date")), ("First decision", run.get("start"))]
    pairs = [(name, long_date(date)) for name, date in dates if date]
    return [*pairs, ("Decisions", number(run.get("horizon"), 0)), ("Prices", str(run.get("model")))]


REPORT = Report("Energy contract", RunFiles, _about, SECTIONS, MENU)
