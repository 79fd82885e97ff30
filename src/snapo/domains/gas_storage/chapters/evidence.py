"""The training history, the assumptions and the units."""

from snapo.report import evidence
from snapo.report.page import Block, Section, Table, Text
from snapo.report.sections.lacking import why_missing

from .run import StorageRun


def history(run: StorageRun) -> Section:
    """The objective and the gradient norm over the steps of training."""
    return evidence.history(run, run.currency)


def assumptions(run: StorageRun) -> Section:
    """The price model, and the meaning of the units."""
    blocks: list[Block] = [Text(str(run.get("model")))] if run.get("model") else []
    if not blocks:
        blocks.append(why_missing(run, "training"))
    title = "Assumptions and units"
    return Section("assumptions", title, "Assumptions", [*blocks, _glossary(run)])


def _glossary(run: StorageRun) -> Table:
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
