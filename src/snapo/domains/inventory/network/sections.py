"""The places of a network in a table."""

from snapo.report.folder import Folder
from snapo.report.page import Section, Table, Text
from snapo.report.quantity import decimals, number, percent, plus_minus
from snapo.report.sections.lacking import lacking


def places(run: Folder) -> Section:
    """Stock, demand and fill rate of every place, and what stores send one another."""
    title, short = "Places", "Places"
    rows = run.get("places", [])
    if not rows:
        return Section("places", title, short, [lacking(run, "service")])
    unit = str(run.get("item_unit", ""))
    digits = decimals([row["stock"]["value"] for row in rows], 4)
    ways = [way for way in ("sent", "received") if any(way in row for row in rows)]
    lots = [way for way in ("orders", "order_size") if any(way in row for row in rows)]
    cells = [
        (
            str(row["name"]),
            str(row["supplier"]) or "outside",
            number(row["level"]["value"], 2),
            number(row["stock"]["value"], digits),
            plus_minus(row["stock"]["standard_error"], digits),
            number(row.get("demand", {}).get("value"), digits),
            percent(row.get("fill_rate", {}).get("value"), 2),
            *(number(row.get(way, {}).get("value"), digits) for way in ways),
            *(number(row.get(way, {}).get("value"), 2) for way in lots),
        )
        for row in rows
    ]
    head = [("Place", ""), ("Supplied by", ""), ("Orders up to", unit), ("Stock", unit), ("", ""),
            ("Demand", unit), ("Fill rate", "")]  # fmt: skip
    head += [(way.capitalize(), unit) for way in ways]
    head += [("Orders", f"1/{run.get('step', 'period')}"), ("Order size", unit)] if lots else []
    words = (
        "Stock is the average on hand at the end of a period. The level up to which a place orders "
        "is the mean over periods of all goods at the place, on their way to it and further down, "
        "less demand that waits, with its order."
    )
    if ways:
        words += " Sent and received is what stores send one another in a period."
    if lots:
        words += " Where an order has a cost of its own, the level is the mean over its orders."
    table = Table(head, cells, "Stock and service by place", 2)
    return Section("places", title, short, [table, Text(words, caveat=True)])
