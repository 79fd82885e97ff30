"""The first screen and the reconciliation: is this the fund that the actuary knows?"""

import re
from typing import Any

import numpy as np

from snapo.report.bands import Layer, stack
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Headline, Mark, Missing, Section, Table, Text
from snapo.report.quantity import MINUS, decimals, finite, number, percent, plus_minus, power

from .evidence import checks
from .regulation import regulation
from .run import PensionRun, points, share

CAVEAT = (
    "Every basis discounts the same expected payments at annual rates of the curve plus its"
    " margin; mortality is that of the case on all of them. The payments of the recovery plan are"
    " level, at the end of each year, and worth the deficit on technical provisions."
)


def funding(run: PensionRun) -> list[Block]:
    """Blocks of the reconciliation; none where the case has no `[funding]`."""
    found = run.get("reconciliation.funding")
    if not found:
        return []
    scale, unit = run.size(found["bases"][0].get("liability"))
    rows = [
        (
            each["name"],
            percent(each.get("margin"), 2),
            number((finite(each.get("liability")) or 0.0) / scale, 2),
            number((finite(each.get("surplus")) or 0.0) / scale, 2),
            share(finite(each.get("ratio")) or 0.0),
            number(each.get("duration"), 1),
        )
        for each in found["bases"]
    ]
    head = [("Basis", ""), ("Over gilts", ""), ("Liability", unit), ("Surplus", unit)]
    head += [("Funding ratio", "%"), ("Duration", "years")]
    table = Table(head, rows, "The bases of funding side by side", 1)
    plan, state = found["recovery"], "at" if found.get("mature") else "before"
    facts = [("Maturity", f"{state} significant maturity", "by duration on low dependency")]
    if finite(plan.get("deficit")):
        years, whole = number(plan.get("years"), 1), run.large(plan.get("total"))
        when = f"a year for {years} years, {whole} in all"
        facts.append(("Recovery plan", run.large(plan.get("each")), when))
    source = f"Rules from {found.get('since')}: {found.get('source')}."
    return [table, Facts(facts), Text(CAVEAT, caveat=True), Text(source, caveat=True)]


NAMES = {"liability": "Liability today", "duration": "Duration of the liability"}


def headline(run: PensionRun) -> Section:
    """The value of the policy, and its trades today."""
    value = finite(run.result.get("value"))
    if value is None and run.left_out("training"):
        text = "This run trained no policy: training is not among the `[report] parts`."
        return Section("headline", "Result", "", [Text(text), *_facts(run)])
    if value is None:
        status = run.result.get("status") or "unknown"
        text = f"There is no value in result.json (status: {status})."
        return Section("headline", "Result", "", [Missing(text)])
    found = checks(run)
    failed = [name for name, passed in found if not passed]
    marks = [Mark(True, f"all {len(found)} checks hold")] if found and not failed else []
    if failed:
        marks = [Mark(False, f"{len(failed)} of {len(found)} checks fail: {', '.join(failed[:3])}")]
    sure, error = finite(run.get("objective.equivalent")), run.get("objective.equivalent_error")
    aversion = number(run.get("objective.aversion"), 1)
    if sure is not None:
        name = "pension" if run.get("objective.output") == "pension" else "funding ratio"
        label = f"Certainty-equivalent {name} {run.horizon} ({run.measure})"
        shown, spread = share(sure), plus_minus(100 * (finite(error) or 0.0), 2)
        over = " to today's pension" if name == "pension" else ""
        note = f"The sure ratio{over} that is worth as much as the policy's, at risk aversion"
        note = f"{note} {aversion};"
    else:
        label, shown = f"Value of the objective ({run.measure})", number(value)
        spread, note = plus_minus(run.result.get("standard_error"), 4), "The objective of the case,"
    block = Headline(
        label=label,
        value=shown,
        error=spread,
        note=f"{note} exact simulator on fresh scenarios, ± one standard error.",
        action=_action(run),
        sentence=_sentence(run),
        when="Today's decision",
        marks=marks,
    )
    return Section("headline", "Result", "", [block, *_facts(run)])


def _moves(run: PensionRun) -> list[dict]:
    rows = run.get("trades.classes", [])
    return sorted(rows, key=lambda each: -abs(finite(each.get("trade")) or 0.0))


def _action(run: PensionRun) -> str:
    moved = sum(abs(finite(each.get("trade")) or 0.0) for each in _moves(run)) / 2
    assets = finite(run.get("assets"))
    if not assets or run.left_out("today"):
        return ""
    return f"Turn over {share(moved / assets)} of the assets"


def _sentence(run: PensionRun) -> str:
    rows = [each for each in _moves(run)[:4] if finite(each.get("trade"))]
    parts = [
        f"{each['name']} {share(each['now'], 0)} → {share(each['target'], 0)}" for each in rows
    ]
    swaps = run.get("trades.swaps", [])
    whole = sum(finite(each.get("target")) or 0.0 for each in swaps)
    text = f"Largest trades: {'; '.join(parts)}." if parts else ""
    return f"{text} Swaps: {run.large(whole)} receiver notional." if swaps else text


def _facts(run: PensionRun) -> list[Facts]:
    """Today's balance and the risk at the horizon; none of a part that was not asked for."""
    last = run.get("by_year", {})
    under = (last.get("underfunded") or [None])[-1]
    short = (last.get("shortfall") or [None])[-1]
    if run.get("personal"):
        found = _facts_of_pots(run)
    else:
        found = {
            "reconciliation": [
                ("Funding ratio today", share(run.get("funding")), "assets over liability"),
                ("Assets", run.large(run.get("assets")), "market value today"),
                ("Liability", run.large(run.get("liability")), "on the case's basis"),
            ],
            "paths": [
                ("Underfunded", share(under), f"probability of F < 1 {run.horizon}, {run.measure}"),
                ("CVaR of the shortfall", share(short), "mean of F − 1 in the worst 5 %, below 0"),
            ],
        }
    facts = [each for part, rows in found.items() if not run.left_out(part) for each in rows]
    return [Facts(facts)] if facts else []


def _facts_of_pots(run: PensionRun) -> dict[str, list[tuple[str, str, str]]]:
    """{part: its facts}."""
    rows = run.get("pots.cohorts", [])
    told = {each["key"]: each["value"] for each in run.get("outputs.outputs", [])}
    cuts = [cut for each in rows if (cut := finite(each.get("cut"))) is not None]
    worst = max(cuts, default=None)
    reserve = run.get("pots.reserve") or [[None] * 3]
    now, last = (f"{share(each[1])}" for each in (reserve[0], reserve[-1]))
    mean, over = share(told.get("funding")), f"of today's, {run.horizon}, {run.measure}"
    left = f"of the assets; median {last} a year before the end"
    return {
        "reconciliation": [
            ("Assets", run.large(run.get("assets")), "market value today, pots and reserve")
        ],
        "outputs": [("Mean pension", mean, over)],
        "pots": [
            ("Pension today", share(run.get("pots.level")), "of what was earned"),
            ("Years with a cut", share(worst), "of those of payment, most of any cohort"),
            ("Solidarity reserve", now, left),
        ],
    }


def reconciliation(run: PensionRun) -> Section:
    """Own figures against those given, and the tests that scenarios must pass."""
    title, short = "Reconciliation", "Reconciliation"
    data = run.get("reconciliation", {})
    if not data:
        text = "The reconciliation is not in this run."
        return Section("reconciliation", title, short, [Missing(text)])
    rows = [_line(each) for each in data.get("lines", [])]
    head = [("Figure", ""), ("", ""), ("This model", ""), ("Given", ""), ("Error", "")]
    blocks: list[Block] = [Text(f"Note: {each}.", caveat=True) for each in data.get("remarks", [])]
    if rows:
        blocks.append(Table(head, rows, "Own figures, and those of the actuary where given", 2))
    if words := data.get("in_words"):
        blocks.append(Text(" ".join(f"{each[:1].upper()}{each[1:]}." for each in words)))
    scale, unit = run.size(data.get("liability"))
    blocks.append(
        Facts(
            [
                ("Liability", f"{number((finite(data.get('liability')) or 0) / scale, 2)}", unit),
                ("Duration", number(data.get("duration"), 2), "years, −d ln L / d parallel shift"),
                ("Convexity", number(data.get("convexity"), 1), "years², of a parallel shift"),
                ("Duration of assets", number(data.get("asset_duration"), 2), "years, with swaps"),
                ("Hedge ratio", percent(data.get("hedge_ratio"), 0), "of a parallel shift"),
                ("Inflation hedge", _hedged(data), "of a rise of all break-evens"),
                ("Inflation +1 bp", run.large(data.get("inflation01"), 3, True), "change of L"),
            ]
        )
    )
    blocks += [*regulation(run), *funding(run)]
    if tests := run.get("market_consistency"):
        blocks.append(_consistency(run, tests))
    if durations := data.get("key_rate_durations"):
        blocks.append(_durations(durations))
    flow = data.get("cash_flow")
    if flow:
        blocks.append(_cash_flow(run, np.asarray(flow, np.float64)))
    return Section("reconciliation", title, short, blocks)


def _hedged(data: dict) -> str:
    ratio = data.get("inflation_hedge_ratio")
    return "none due" if ratio is None else percent(ratio, 0)


def _line(each: dict) -> tuple:
    ok = each.get("ok")
    known = each.get("given") is not None
    verdict = Mark(bool(ok), _word(ok)) if known else "not given"
    name = NAMES.get(str(each.get("name")), str(each.get("name", "")))
    return (
        name[:1].upper() + name[1:],
        verdict,
        number(each.get("own")),
        number(each.get("given")),
        power(each.get("error")) if known else "",
    )


def _word(ok) -> str:
    return "holds" if ok else "fails"


def _consistency(run: PensionRun, tests: list[dict]) -> Table:
    rows = [
        (
            str(each["name"]),
            Mark(bool(each["ok"]), _word(each["ok"])),
            number(each["own"]),
            number(each["expected"]),
            number(each["standard_error"]),
        )
        for each in tests
    ]
    head = [("Test", ""), ("", ""), ("Simulated", ""), ("Expected", ""), ("Standard error", "")]
    caption = "Market consistency under Q on fresh paths with the trained policy, 3 standard errors"
    return Table(head, rows, caption, 2)


def _durations(found: dict) -> Table:
    """Key-rate durations by node, and their sum."""
    years = [finite(each) or 0.0 for each in found["years"]]
    rows = [(label, number(each, 3)) for label, each in zip(found["label"], years)]
    rows.append(("Sum", number(sum(years), 3)))
    caption = "Key-rate durations of the liability: −d ln L / d quote at each node of the curve"
    strong = frozenset([len(rows) - 1])
    folded = f"Key-rate durations at {len(years)} nodes"
    return Table([("Node", ""), ("Years", "")], rows, caption, 1, strong=strong, folded=folded)


def _cash_flow(run: PensionRun, flow: np.ndarray) -> Chart | Text:
    paid = np.flatnonzero(flow > flow.max() * 1e-4)
    if not paid.size:
        return Text("No payments are expected.")
    flow = flow[: paid[-1] + 1]
    scale, unit = run.size(flow)
    layer = Layer("Expected payments", flow / scale, "main", 0.75)
    peak = int(np.argmax(flow))
    alt = f"Expected payments by year; they peak at {run.large(flow[peak])} in year {peak + 1}."
    svg = draw(
        "cash-flow", alt, lambda a: stack(a, np.arange(len(flow)), [layer], f"{unit} a year"), 200
    )
    caption = (
        "Expected payments of the rights accrued today, with mortality as expected and no future"
        f" indexation; in all {run.large(flow.sum())}. Points on the way: "
        + ", ".join(f"year {y} {run.large(flow[y - 1])}" for y in (1, 10, 20) if y <= len(flow))
        + "."
    )
    return Chart(svg, caption)


def _signed(scenario: Any) -> str:
    """The name of a scenario with a true minus before its numbers, and a true sign of times."""
    text = re.sub(r"(?<![\w.])-(?=\d)", MINUS, str(scenario))
    return re.sub(r"(?<= )x(?= \d)", "×", text)


def stress(run: PensionRun) -> Section:
    """The balance sheet at once after each shock of the case's file."""
    title, short = "Stress table", "Stress"
    rows = run.get("stresses", [])
    if not rows:
        text = "The case names no file of shocks (`[stress] file`)."
        return Section("stress", title, short, [Missing(text)])
    now = finite(run.get("funding")) or 0.0
    scale, unit = run.size(run.get("assets"), run.get("liability"))
    body = [
        ("Today", *_balance(run.get("assets"), run.get("liability"), scale), points(now, 1), "")
    ]
    for each in rows:
        amounts = _balance(each.get("assets"), each.get("liability"), scale)
        change = (finite(each.get("funding")) or 0.0) - now
        ratio = points(each.get("funding"), 1)
        body.append((_signed(each["scenario"]), *amounts, ratio, points(change, 1, True)))
    head = [("Scenario", ""), ("Assets", unit), ("Liability", unit), ("Surplus", unit)]
    head += [("Funding ratio", "%"), ("Change", "points")]
    caption = (
        "Instantaneous and fully revalued, present holdings and swaps kept. Classes with a shock of"
        " their own do not react to rates."
    )
    table = Table(head, body, "", 1, strong=frozenset([0]))
    return Section("stress", title, short, [table, Text(caption, caveat=True)])


def _balance(assets, liability, scale: float) -> tuple[str, str, str]:
    a, b = finite(assets) or 0.0, finite(liability) or 0.0
    places = decimals([a / scale, b / scale], 4)  # a surplus is small beside what it is left of
    return number(a / scale, places), number(b / scale, places), number((a - b) / scale, places)
