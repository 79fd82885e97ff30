"""The worth of the contract: the value ladder and the distribution of the total cash flow."""

from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Section, Table, Text
from snapo.report.quantity import SPACE, decimals, finite, number, plus_minus
from snapo.report.sections.lacking import lacking

from .run import Run


def value_ladder(run: Run) -> Section:
    """Every value of the same contract on the same curve, from the least to the best."""
    rungs = [each for each in run.get("value_ladder", []) if finite(each.get("value")) is not None]
    if not rungs:
        return Section("ladder", "Value ladder", "Value", [lacking(run, "value ladder")])
    places = decimals([each["value"] for each in rungs])
    worths = [run.worth(each["value"], each.get("standard_error"), places) for each in rungs]
    # The value of the headline is the bar to look at.
    main = next((i for i, each in enumerate(rungs) if _is_value(run, each)), None)
    strong = [i == main for i in range(len(rungs))]
    bars = [
        charts.Rung(
            str(each["name"]), float(each["value"]), worth, finite(each.get("standard_error")), main
        )
        for each, worth, main in zip(rungs, worths, strong, strict=True)
    ]
    alt = "Horizontal bars. " + "; ".join(f"{bar.name}: {bar.text}" for bar in bars) + "."
    height = 28 + 27 * len(bars)
    svg = draw("ladder", alt, lambda axes: charts.ladder(axes, bars), height)
    caption = (
        "Present values of the same contract on the same curve; whiskers are 95 % intervals. A"
        " policy that can be followed is a lower bound of the optimum."
    )
    blocks: list[Block] = [Chart(svg, caption), _ladder_table(run, rungs, strong, places)]
    costs = finite(run.get("fixed_costs"))
    if costs:
        text = f"Fixed costs have a present value of {run.money(costs)}."
        blocks.append(Text(text))
    return Section("ladder", "Value ladder", "Value", blocks)


def _is_value(run: Run, rung: dict) -> bool:
    return finite(rung["value"]) == finite(run.result.get("value"))


def _ladder_table(run: Run, rungs, strong, places: int) -> Table:
    rows = [
        (
            each["name"],
            each.get("note") or "",
            number(each["value"], places),
            plus_minus(each.get("standard_error"), places),
        )
        for each in rungs
    ]
    chosen = frozenset(i for i, main in enumerate(strong) if main)
    currency = run.currency
    head = [("", ""), ("Meaning", ""), ("Value", currency), ("Standard error", currency)]
    return Table(head, rows, texts=2, strong=chosen)


def cash_flow(run: Run) -> Section:
    """The distribution of the total discounted cash flow over the paths."""
    title, short = "Distribution of the total cash flow", "Cash flow"
    edges, counts = run.numbers("cash_flow.edges"), run.numbers("cash_flow.counts")
    if edges is None or counts is None or len(edges) != len(counts) + 1:
        return Section("cash-flow", title, short, [lacking(run, "value ladder")])
    spread = finite(run.get("cash_flow.standard_deviation"))
    quantiles = run.get("cash_flow.quantiles", {})
    known = {float(q): v for q, each in quantiles.items() if (v := finite(each)) is not None}
    mean = finite(run.get("cash_flow.mean"))
    marks = [] if mean is None else [("mean", mean)]
    marks += [(f"{q:g} %", v) for q, v in known.items() if q in (5, 95, 1, 99)]
    places = decimals(edges)
    note = "" if spread is None else f"±{SPACE}{number(spread, places)} standard deviation"
    facts = [] if mean is None else [("Mean", run.money(mean, places), note)]
    for q, name in (
        (1, "1 % quantile"),
        (5, "5 % quantile"),
        (50, "Median"),
        (95, "95 % quantile"),
    ):
        if q in known:
            facts.append((name, run.money(known[q], places), ""))
    alt = "Histogram of the total cash flow per path. " + "; ".join(
        f"{text}: {run.money(v, places)}" for text, v in marks
    )
    unit = f"Total discounted cash flow, {run.currency}" if run.currency else "Total cash flow"
    svg = draw("cash-flow-bins", alt, lambda a: charts.histogram(a, edges, counts, marks, unit))
    caption = (
        "Earnings of the storage alone on one path, unhedged; trading the deltas above takes most"
        " of this spread out."
    )
    blocks = [Chart(svg, caption), Facts(facts)]
    return Section("cash-flow", title, short, blocks)
