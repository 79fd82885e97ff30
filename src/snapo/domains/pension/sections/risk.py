"""Sensitivities: the tornado, key rates of the strategy, all others."""

from snapo.report.bands import Swing, tornado
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section, Table, Text
from snapo.report.quantity import SPACE, decimals, finite, number, plus_minus, rough

from .run import PensionRun
from .words import name_of

CURVE = "curve"  # the group of inputs that are nodes of a curve
HELD = (
    "Held: every path trades as it did, which at an optimum is also the effect on the re-optimised"
    " policy, to first order; through the policy: a bump of the exact fund, where it refutes that."
    " The 95 % interval adds the sampling error and the error of the policy."
    " Reacting: the trained policy sees the moved fund and"
    " answers by its rule, not trained anew; the distance between the two is left by training"
    " and smoothing. Prices of risk, excess returns and today's market values are held while"
    " the curve moves."
)
TOP = 14
TEXTS = frozenset({0, 1, 5})  # columns of text in the tables of single numbers


def half_width(row: dict) -> float:
    """Half the width of a row's interval; 0 where it has none."""
    low, high = finite(row.get("low")), finite(row.get("high"))
    return 0.0 if low is None or high is None else (high - low) / 2


def _scale(run: PensionRun) -> tuple[float, str]:
    """The factor of effects, and their unit."""
    if run.get("sensitivities.unit") == "ratio":
        return 1e4, "bp of the certainty equivalent"
    return 1.0, "objective"


def sensitivities(run: PensionRun) -> Section:
    """Every input moved by its usual step."""
    title, short = f"Sensitivities of the objective ({run.measure})", "Sensitivities"
    families = run.get("sensitivities.families", [])
    if not families:
        text = "Sensitivities are not in this run."
        return Section("sensitivities", title, short, [Missing(text)])
    scale, unit = _scale(run)
    moves = [*families, *run.get("sensitivities.combined", [])]
    blocks: list[Block] = [_tornado(moves, scale, unit)]
    blocks.append(_families(moves, scale, unit))
    rows = run.get("sensitivities.rows", [])
    curves = dict.fromkeys(row["input"] for row in rows if row.get("group") == CURVE)
    for name in curves:
        own = [row for row in rows if row["input"] == name]
        whole = next(each for each in families if each["input"] == name)
        blocks.append(_nodes(whole, own, scale, unit))
    others = [row for row in rows if row["input"] not in curves]
    if others:
        blocks.append(_others(others, scale, unit))
    blocks += [Text(HELD, caveat=True), _definitions(moves)]
    return Section("sensitivities", title, short, blocks)


def _tornado(families: list[dict], scale: float, unit: str) -> Chart:
    order = sorted(families, key=lambda each: -abs(finite(each["effect"]) or 0.0))[:TOP]
    places = decimals([scale * (finite(each["effect"]) or 0.0) for each in order], 3)
    swings = []
    for each in order:
        value = scale * (finite(each["effect"]) or 0.0)
        half = scale * half_width(each)
        count = f", all {each['count']}" if each["count"] > 1 else ""
        name = f"{name_of(each['input'])}{count}: +{SPACE}{each['move']}"
        swings.append(Swing(name, value, number(value, places, True), half))
    alt = "Effects of the usual moves. " + "; ".join(f"{s.name}: {s.text}" for s in swings)
    svg = draw("tornado", alt, lambda axes: tornado(axes, swings, unit), 40 + 22 * len(swings))
    caption = "The largest effects, all numbers of an input moved together; whiskers: 95 %."
    return Chart(svg, caption)


def _families(families: list[dict], scale: float, unit: str) -> Table:
    rows = [_row(each, name_of(each["input"]), scale, each["count"]) for each in families]
    head = [("Input", ""), ("Numbers", ""), ("Rise of each", ""), *_columns(unit)]
    caption = "All numbers of an input together; for a curve this is the parallel shift"
    return Table(head, rows, caption, frozenset({0, 2, 6}))


def _row(each: dict, name: str, scale: float, count: int | None = None) -> tuple:
    effect, half = finite(each["effect"]), scale * half_width(each)
    # No digit beyond the interval's second one; six of the effect where it is hardly wide.
    places = decimals([scale * (effect or 0.0)], 6 if half else 4)
    places = min(decimals([half], 2), places) if half else places
    reacting = finite(each.get("reacting"))
    numbers = () if count is None else (str(count),)
    return (
        name,
        *numbers,
        each["move"] if count is None else str(each["move"]).replace(" ", SPACE),
        number(None if effect is None else scale * effect, places, True),
        plus_minus(half if effect is not None else None, places),
        rough(scale * (finite(each.get("policy")) or 0.0)),
        str(each.get("source") or ""),
        number(None if reacting is None else scale * reacting, places, True),
    )


def _columns(unit: str) -> list[tuple[str, str]]:
    """Heads of the columns that tell of one effect."""
    return [("Effect", unit), ("95 % half-width", unit), ("of it policy", unit), ("Derivative", ""),
            ("Policy reacting", unit)]  # fmt: skip


def _nodes(whole: dict, rows: list[dict], scale: float, unit: str) -> Table:
    """One line per node, and the `whole` input moved at once: the parallel shift, which is their
    sum."""
    name = name_of(whole["input"])
    body = [_row(each, each["label"], scale) for each in rows]
    body.append(_row(whole, "Parallel = sum", scale))
    head = [("Node", ""), ("Rise", ""), *_columns(unit)]
    folded = f"{name} by node: {len(rows)} key rates"
    strong = frozenset([len(body) - 1])
    return Table(head, body, f"Key rates: {name}", TEXTS, strong=strong, folded=folded)


def _others(rows: list[dict], scale: float, unit: str) -> Table:
    body = [_row(each, name_of(each["input"], each["label"]), scale) for each in rows[:400]]
    head = [("Input", ""), ("Rise", ""), *_columns(unit)]
    more = "" if len(rows) <= 400 else "; the rest is in sensitivities.csv"
    folded = f"Each number alone: {len(rows)} sensitivities{more}"
    return Table(head, body, "Each number alone", TEXTS, folded=folded)


def _definitions(families: list[dict]) -> Table:
    rows = [
        (name_of(each["input"]), f"+ {each['move']}: {each.get('words', '')}") for each in families
    ]
    return Table([("Input", ""), ("The move", "")], rows, "Definitions", 2)
