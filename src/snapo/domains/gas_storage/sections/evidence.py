"""Why to believe the number: training history, certificate, assumptions and versions."""

from snapo.report import evidence
from snapo.report.evidence import checks as checks
from snapo.report.page import Block, Facts, Section, Table, Text
from snapo.report.quantity import decimals, finite, long_date, number, percent, power
from snapo.report.sections.lacking import lacking

from .run import Run


def history(run: Run) -> Section:
    """The objective and the gradient norm over the steps of training."""
    return evidence.history(run, run.currency)


def certificate(run: Run) -> Section:
    """Every test that this very run was put to."""
    title = "Certificate: why to believe this number"
    if not run.get("certificate"):
        return Section("certificate", title, "Certificate", [lacking(run, "certificate")])
    blocks: list[Block] = []
    if facts := _facts(run):
        blocks.append(Facts(facts))
    blocks += [
        evidence.bump_table(run, run.currency, lambda name: run.said(name).title()),
        evidence.limit_table(run, run.volume, "Day", lambda step: _day(run, step)),
    ]
    return Section("certificate", title, "Certificate", blocks)


def _facts(run: Run) -> list[tuple[str, str, str]]:
    facts = []
    gap = finite(run.get("certificate.smoothing_gap", run.result.get("smoothing_gap")))
    if gap is not None:
        value = finite(run.result.get("value"))
        share = f" ({percent(gap / abs(value), 2)})" if value else ""
        facts.append(("Smoothing gap", run.money(gap), f"exact less smooth{share}"))
    facts += evidence.gradient(run)
    left, right, error = (
        finite(run.get(f"certificate.homogeneity.{key}")) for key in ("left", "right", "error")
    )
    if left is not None and right is not None:
        places = decimals([left, right])
        note = f"value + costs: {run.money(right, places)}; difference {power(error)}"
        facts.append(("Σ forward × delta", run.money(left, places), note))
    facts += [
        (f"Control variate: {key.replace('_', ' ')}", _plain(value), "")
        for key, value in run.get("certificate.control_variate", {}).items()
    ]
    return facts


def _plain(value) -> str:
    return number(value) if finite(value) is not None else str(value)


def _day(run: Run, step) -> str:
    known, when = finite(step), run.days
    if known is None or when is None or not 0 <= known < len(when):
        return number(known, 0)
    return long_date(when[int(known)])


def assumptions(run: Run) -> Section:
    """The price model, and the meaning of the units."""
    blocks: list[Block] = [Text(str(run.get("model")))] if run.get("model") else []
    if not blocks:
        blocks.append(lacking(run, "training"))
    title = "Assumptions and units"
    return Section("assumptions", title, "Assumptions", [*blocks, _glossary(run)])


def _glossary(run: Run) -> Table:
    money, gas = run.currency or "currency", run.volume
    rows = [
        ("Value", money, "present value on the valuation date, contract as written"),
        ("Price", run.price, "forward and spot prices, trigger prices, undiscounted"),
        ("Volume", gas, "inventory, and volume per day for flows and rates"),
        ("Delta", gas, "change of value for a rise of 1 in one forward price, decisions held"),
        ("Discounted delta", gas, "delta of the present value; divided by the discount factor of"
         " the month's settlement it is the volume of futures"),
        ("Intrinsic", gas, "volumes of the best plan fixed today on the forward curve"),
        ("Smooth delta", gas, "through the smooth policy's own reaction; a diagnostic"),
        ("Volatility", "per √year", "of the logarithm of the price; 1 point is 0.01"),
        ("Standard error", "", "of the estimate; 95 % is ± 1.96 of them, of a delta ± 2.04"),
        ("Cycles", "", "volume injected over the life, divided by the working volume"),
    ]  # fmt: skip
    return Table([("Term", ""), ("Unit", ""), ("Meaning", "")], rows, "Terms and units", 3)
