"""The cost that a planner came for, with the service it buys; and the parts of the cost."""

from snapo.report.evidence import notes
from snapo.report.folder import Folder
from snapo.report.page import Block, Facts, Headline, Section, Table
from snapo.report.quantity import decimals, finite, measured, number, percent, plus_minus, quantity
from snapo.report.sections.lacking import lacking
from snapo.study.chapters.headline import marks

SHARES = {
    "fill_rate": ("Fill rate", "of demand is met from stock at once"),
    "cycle_service": ("Cycle service", "of replenishment cycles have no unmet demand"),
    "period_service": ("Periods without shortage", "of all periods"),
}
AMOUNTS = {
    "stock": ("Average stock", "at the end of a period"),
    "orders": ("Orders", "in a period"),
    "order_size": ("Order size", "mean"),
    "demand": ("Demand", "of a period, mean"),
}


def service(run: Folder) -> Section:
    """The cost of the trained rule, and the service."""
    title, value = "Cost and service", finite(run.result.get("value"))
    if value is None:
        return Section("value", title, "Cost", [lacking(run, "training")])
    error = finite(run.result.get("standard_error"))
    places = decimals([value], 6) if not error else max(0, decimals([error], 2))
    if run.unit:
        label, shown = "Cost", quantity(-value, run.unit, places)
    else:
        label, shown = "Value", number(value, places)
    note = (
        f"{run.get('objective', 'the objective')}; on fresh paths of the exact simulator, "
        "± one standard error"
    )
    top = Headline(label, shown, plus_minus(error, places), note, marks=marks(run))
    blocks: list[Block] = [top, *notes(run)]
    blocks += [_facts(run), _costs(run)] if run.get("service") else [lacking(run, "service")]
    return Section("value", title, "Cost", blocks)


def _facts(run: Folder) -> Facts:
    found = []
    for name, (words, what) in SHARES.items():
        each = run.get(f"service.{name}")
        if each is None:
            continue
        error = finite(each.get("standard_error"))
        off = f" ({plus_minus(100 * error, 2)})" if error is not None else ""
        found.append((words, percent(each.get("value"), 2), f"{what}{off}"))
    for name, (words, what) in AMOUNTS.items():
        each = run.get(f"service.{name}")
        if each is None:
            continue
        unit = "" if name == "orders" else str(run.get("item_unit", ""))
        places = max(0, decimals([each.get("value")], 4))
        found.append((words, quantity(each.get("value"), unit, places), what))
    return Facts(found)


def _costs(run: Folder) -> Table:
    rows = run.get("costs", [])
    total = sum(float(each["value"]) for each in rows) or 1.0
    places = decimals([total], 5)
    cells = [
        (
            str(each["name"]).capitalize(),
            *measured(each["value"], each.get("standard_error"), places),
            percent(float(each["value"]) / total),
        )
        for each in rows
    ]
    cells.append(("Together", number(total, places), "", percent(1.0)))
    unit = str(run.get("units", {}).get("holding", ""))
    head = [("Cost", ""), ("", unit), ("", ""), ("Share", "")]
    return Table(head, cells, "Cost by part", 1, strong=frozenset([len(cells) - 1]))
