"""Sensitivities of several outputs side by side: a board's page, then each in its units."""

from snapo.report.page import Block, Facts, Missing, Section, Table, Text
from snapo.report.quantity import SPACE, decimals, finite, measured, number, plus_minus

from .run import PensionRun, share
from .words import name_of

SHOWN = 12
OBJECTIVE = "Objective"  # its name where it is a utility, which has no unit
CAVEAT = (
    "First-order effects of the usual moves, decisions held, one adjoint pass for each output over"
    " the same paths. Points are hundredths of the funding ratio or of probability; money is that"
    " share of today's liability, and for contributions their present value itself. The probability"
    " is the exact share of paths; its effects are those of a logistic step of width 2 points, the"
    " mean of 1 / (1 + exp((F − 1) / 0.02)). A utility as objective is in units of its own. Every"
    " number: outputs.csv."
)
OF_POTS = (
    ("hundredths of the funding ratio", "hundredths of today's pension"),
    ("money is that share of today's liability, and for contributions their present value itself",
     "for contributions money is their present value"),
    ("exp((F − 1) / 0.02))", "exp((P − 1) / 0.02)), P being the pension over today's"),
)  # fmt: skip


def outputs(run: PensionRun) -> Section:
    """The largest effects on all outputs, and every one with its error."""
    title, short = f"Several outputs at once ({run.measure})", "Outputs"
    every, families = run.get("outputs.outputs", []), run.get("outputs.families", [])
    if not every or not families:
        text = "Sensitivities of further outputs are not in this run."
        return Section("outputs", title, short, [Missing(text)])
    order = sorted(families, key=lambda each: -_largest(run, each, every))
    facts = [(each["name"], *_value(run, each)) for each in every if each["name"] != OBJECTIVE]
    blocks: list[Block] = [Facts(facts), _summary(run, every, order[:SHOWN])]
    blocks += [_detail(run, each, order) for each in every]
    blocks.append(Text(_caveat(run), caveat=True))
    return Section("outputs", title, short, blocks)


def _caveat(run: PensionRun) -> str:
    text = CAVEAT
    for old, new in OF_POTS if run.get("personal") else ():
        text = text.replace(old, new)
    return text


def _value(run: PensionRun, each: dict) -> tuple[str, str]:
    if each["money"]:
        return run.large(each["value"]), f"±{SPACE}{run.large(each['error'])}"
    return share(each["value"]), f"{plus_minus(100 * (finite(each['error']) or 0), 2)} points"


def _as_share(run: PensionRun, each: dict, effect) -> float:
    """An effect as a share: of the ratio, of probability, or money over today's liability."""
    known, owed = finite(effect) or 0.0, finite(run.get("liability")) or 1.0
    return known / owed if each["money"] else known


def _largest(run: PensionRun, family: dict, every: list[dict]) -> float:
    """The largest effect among the outputs that have a unit."""
    effects = family["effects"]
    own = [each for each in every if each["name"] != OBJECTIVE]
    return max(abs(_as_share(run, each, effects[each["key"]][0])) for each in own)


def _name(family: dict) -> str:
    count = f", all {family['count']}" if family["count"] > 1 else ""
    return f"{name_of(family['input'])}{count}: +{SPACE}{family['move']}"


def _summary(run: PensionRun, every: list[dict], families: list[dict]) -> Table:
    """One line for each input, one column for each output: points, contributions in money."""
    columns, head = [], [("Move", "")]
    for each in every:
        effects = [finite(family["effects"][each["key"]][0]) or 0.0 for family in families]
        scale, unit = 0.01, "points"
        if each["name"] == OBJECTIVE:
            scale, unit = 1.0, ""
        elif each["money"]:
            scale, unit = run.size(effects)
        places = decimals([value / scale for value in effects], 3)
        columns.append([number(value / scale, places, True) for value in effects])
        head.append((each["name"], unit))
    rows = [(_name(family), *cells) for family, *cells in zip(families, *columns)]
    return Table(head, rows, "The largest effects of the usual moves on each output", 1)


def _detail(run: PensionRun, each: dict, families: list[dict]) -> Table:
    """All inputs for one output, in points, basis points and money, with the error."""
    owed = finite(run.get("liability")) or 0.0
    unitless = each["name"] == OBJECTIVE
    valued = each["money"] or not run.get("personal")  # a share of a pension is no sum of money
    rows = []
    for family in families:
        effect, error = (finite(x) or 0.0 for x in family["effects"][each["key"]])
        if unitless:
            rows.append((_name(family), number(effect, None, True), plus_minus(error, 6)))
            continue
        part, spread = _as_share(run, each, effect), _as_share(run, each, error)
        money = run.large(part * owed, 2, True)
        cells = measured(100 * part, 100 * spread, 3, True)
        rows.append((_name(family), *cells, number(1e4 * part, 1, True), *[money][: int(valued)]))
    head = [("Move", ""), ("Effect", "" if unitless else "points"), ("Std. error", "")]
    head += [] if unitless else [("Effect", "bp"), *[("In money", run.currency)][: int(valued)]]
    caption = f"Effects on: {each['name']}"
    return Table(head, rows, caption, 1, folded=f"{each['name']}: every input")
