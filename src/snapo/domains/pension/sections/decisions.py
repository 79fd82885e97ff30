"""The policy: today's trades, its weights over time and funding ratio, its rivals."""

from itertools import pairwise

import numpy as np

from snapo.report.bands import Layer, heat, scatter, stack
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Missing, Section, Table, Text
from snapo.report.quantity import finite, number, plus_minus

from .run import PensionRun, points, share

BREACHES = (("collateral", "Collateral falls short"), ("weights", "Weights leave their bounds"))
LAYERS = ("main", "inject", "withdraw", "limit", "good", "other")


def trades(run: PensionRun) -> Section:
    """Today's list from the present weights to the policy's, and the swaps."""
    title, short = "Today's trades", "Trades"
    rows = run.get("trades.classes", [])
    if not rows:
        return Section("trades", title, short, [Missing("Today's trades are not in this run.")])
    scale, unit = run.size([each.get("trade") for each in rows])
    body = [
        (
            str(each["name"]),
            _verb(each.get("trade"), scale),
            points(each["now"], 1),
            points(each["target"], 1),
            f"{points(each.get('low'), 0)} – {points(each.get('high'), 0)}",
            number((finite(each["trade"]) or 0.0) / scale, 2, True),
            number((finite(each.get("cost")) or 0.0) / scale, 3),
        )
        for each in rows
    ]
    names = (("Class", ""), ("", ""), ("Now", "%"), ("Policy", "%"), ("Bounds", "%"))
    head = [*names, ("Trade", unit), ("Cost", unit)]
    blocks: list[Block] = [Table(head, body, "Classes", 2)]
    swaps = run.get("trades.swaps", [])
    if swaps:
        scale, unit = run.size([each.get(key) for each in swaps for key in ("now", "target")])
        lines = [
            (
                str(each["tenor"]),
                _verb(each.get("trade"), scale),
                *(number((finite(each[key]) or 0.0) / scale, 2) for key in ("now", "target")),
                number((finite(each["trade"]) or 0.0) / scale, 2, True),
            )
            for each in swaps
        ]
        head = [("Swap", ""), ("", ""), ("Now", unit), ("Policy", unit), ("Trade", unit)]
        blocks.append(Table(head, lines, "Receiver swaps: notionals", 2))
    return Section("trades", title, short, blocks)


def _verb(value, scale: float) -> str:
    known = finite(value) or 0.0
    if abs(known) < 0.005 * scale:
        return "keep"
    return "buy" if known > 0 else "sell"


def policy(run: PensionRun) -> Section:
    """The policy drawn as weights over funding ratio and time, and its mean mix."""
    title, short = f"The policy ({run.measure})", "Policy"
    table, years = run.get("policy_map.growth"), run.get("policy_map.years")
    if not table or not years:
        return Section("policy", title, short, [Missing("The policy is not in this run.")])
    blocks: list[Block] = []
    for name, words in (
        ("growth", "share of equity, property and other risky classes"),
        ("hedge", "mean place of the swap notionals between their limits"),
    ):
        values = run.get(f"policy_map.{name}")
        if not values:
            continue
        grid = np.array([[np.nan if v is None else v for v in row] for row in values])
        kept = _rows(len(years))
        grid = grid[kept]
        across = _ratios(run.get("policy_map.ratios", []))
        down = [f"year {number(years[i] + 1, 0)}" for i in kept]
        alt = f"Map of the {words}, by funding ratio across and year upwards."
        height = 60.0 + 19 * len(kept)
        svg = draw(
            f"map-{name}",
            alt,
            lambda axes, grid=grid, across=across, down=down: heat(axes, grid, across, down, "%"),
            height,
        )
        caption = (
            f"{words[:1].upper()}{words[1:]}, in per cent: means over the paths that are at that"
            " funding ratio in that year; empty where hardly any is."
        )
        blocks.append(Chart(svg, caption))
    if (mix := _mix(run)) is not None:
        blocks.append(mix)
    return Section("policy", title, short, blocks)


def _rows(count: int) -> list[int]:
    step = max(1, -(-count // 12))
    return list(range(0, count, step))


def _ratios(edges: list) -> list[str]:
    """["below 80 %", "80–90 %", …, "150 % and more"]."""
    known = [None if each is None else 100 * float(each) for each in edges]
    texts = []
    for low, high in pairwise(known):
        if not low:
            texts.append(f"below {number(high, 0)} %")
        elif high is None:
            texts.append(f"{number(low, 0)} % up")
        else:
            texts.append(f"{number(low, 0)}–{number(high, 0)} %")
    return texts


def _mix(run: PensionRun) -> Chart | None:
    weights, names = run.get("mix.weights"), run.get("mix.classes", [])
    years = run.numbers("mix.years")
    if not weights or years is None:
        return None
    mean = np.array(weights, np.float64)
    order = np.argsort(-np.abs(mean.mean(1)), kind="stable")
    kept, rest = order[:5], order[5:]
    layers = [
        Layer(names[i], 100 * mean[i], colour, 0.8) for i, colour in zip(kept, LAYERS, strict=False)
    ]
    if rest.size:
        layers.append(Layer("All others", 100 * mean[rest].sum(0), LAYERS[5], 0.5))
    alt = "Mean weights by class at the start of each year. " + "; ".join(
        f"{each.label} {number(each.values[0], 0)} % now" for each in layers
    )
    svg = draw("mix", alt, lambda axes: stack(axes, years, layers, "%"), 240)
    text = "Mean weights at the start of each year, over all paths."
    if mean.min() < 0:
        text += " Below zero: sold short, or borrowed."
    return Chart(svg, text)


def rivals(run: PensionRun) -> Section:
    """The learned policy against the classical ones on the same fresh paths."""
    title, short = f"Learned and classical policies ({run.measure})", "Policies"
    rows = run.get("policies", [])
    if len(rows) < 2:
        text = "No classical policies were tuned in this run."
        return Section("policies", title, short, [Missing(text)])
    sure = all(finite(each.get("equivalent")) is not None for each in rows)
    body = [_rival(run, each, sure) for each in rows]
    head = [("Policy", "")]
    if sure:
        head += [("Certainty equivalent", "%"), ("Learned leads by", "bp a year"), ("Error", "bp")]
    else:
        head += [("Objective", ""), ("Learned leads by", ""), ("Error", "")]
    _, unit = run.size([each.get("pv_contribution") for each in rows])
    words = ("Median pension", "Below today's") if run.get("personal") else ("Median F", "P(F < 1)")
    head += [(words[0], "%"), ("5 % quantile", "%"), (words[1], "%"), ("PV contributions", unit)]
    caption = (
        "All on the same fresh paths, the classical ones tuned on the same objective within the"
        " same bounds; the present mix is held as it is, untuned. The lead is paired path by path;"
        " the error is one standard error of it."
    )
    table = Table(head, body, "", 1, strong=frozenset([0]))
    return Section("policies", title, short, [table, Text(caption, True), _cloud(run, rows, unit)])


def _cloud(run: PensionRun, rows: list[dict], unit: str) -> Chart:
    """Contributions of each policy against the funding ratio in bad times."""
    marks = [
        (
            str(each["name"]),
            (finite(each.get("pv_contribution")) or 0.0) / run.size(each["pv_contribution"])[0],
            100 * (finite(each.get("p05")) or 0.0),
            each["key"] == "learned",
        )
        for each in rows
    ]
    name, short = "funding ratio", "F"
    if run.get("personal"):
        name = short = "pension over today's"
    units = (f"Mean present value of contributions, {unit}", f"5 % quantile of {short}, %")
    alt = f"Policies by present value of contributions and 5 % quantile of the {name}."
    svg = draw("frontier", alt, lambda axes: scatter(axes, marks, units), 230)
    text = f"Contributions against the {name} in bad times; up and left is better."
    return Chart(svg, text)


def _rival(run: PensionRun, each: dict, sure: bool) -> tuple:
    learned = each["key"] == "learned"
    if sure:
        known = [points(each["equivalent"], 2)]
        lead, error = finite(each.get("lead")), finite(each.get("lead_error"))
        known += ["", ""] if learned else [number(1e4 * (lead or 0.0), 1, True)]
        known += [] if learned else [plus_minus(1e4 * (error or 0.0), 1)]
    else:
        known = [number(each["value"])]
        known += ["", ""] if learned else [number(each["difference"], None, True)]
        known += [] if learned else [plus_minus(each["difference_error"], 4)]
    scale, _ = run.size(each.get("pv_contribution"))
    return (
        str(each["name"]),
        *known,
        points(each.get("median"), 1),
        points(each.get("p05"), 1),
        points(each.get("underfunded"), 1),
        number((finite(each.get("pv_contribution")) or 0.0) / scale, 2),
    )


def limits(run: PensionRun) -> Section:
    """Collateral: headroom today; and by month, paths that break a limit."""
    title, short = f"Collateral and limits ({run.measure})", "Limits"
    now, after = run.get("collateral.now"), run.get("collateral.after")
    broken = run.get("limits", {})
    if not now and not broken:
        return Section("collateral", title, short, [Missing("Limits are not in this run.")])
    facts = []
    if now:
        facts = [_headroom(run, "Headroom now", now), _headroom(run, "After today's trades", after)]
        required = f"{number(now.get('required'), 0)} bp"
        facts.append(("Required", required, "rise in rates to be withstood"))
    for name, words in BREACHES:
        if name in broken:
            note = f"probability in any month, {run.measure}"
            facts.append((words, share(broken[name]["ever"], 2), note))
    blocks: list[Block] = [Facts(facts)]
    if not now and not run.left_out("today"):
        blocks.append(Text("The case has no swaps, and needs no collateral."))
    for name, words in BREACHES:
        months = run.numbers(f"limits.{name}.share")
        if months is not None:
            blocks.append(_months(run, name, words, months))
    return Section("collateral", title, short, blocks)


def _months(run: PensionRun, name: str, words: str, months: np.ndarray) -> Chart | Text:
    """Shares of the paths that break one limit, step by step."""
    if not np.any(months > 0):
        return Text(f"{words}: on no path in any month.")
    worst = int(np.nanargmax(months))
    years = np.arange(len(months)) * float(run.get("step") or 1.0)
    layer = Layer(words, 100 * months, "limit", 0.8)
    text = f"{words} most often in step {worst + 1}: on {share(months[worst], 2)} of the paths."
    svg = draw(f"breach-{name}", text, lambda axes: stack(axes, years, [layer], "% of paths"), 180)
    return Chart(svg, f"{text} Shares of the paths by month.")


def _headroom(run: PensionRun, name: str, each: dict | None) -> tuple[str, str, str]:
    known = finite((each or {}).get("headroom"))
    if each is None or (known is None and not each.get("enough")):
        return name, "no swaps", "nothing to be collateralised"
    note = f"{run.large(each.get('eligible'))} eligible, PV01 {run.large(each.get('pv01'), 2)}"
    if each.get("direction") == "fall":
        note = f"{note}; of a fall in rates"
    return name, "no limit" if known is None else f"{number(known, 0)} bp", note
