"""The fund before its regulator: required own funds by risk, and the way back to them."""

from snapo.report.page import Block, Facts, Table, Text
from snapo.report.quantity import finite, number

from .run import PensionRun, share

RISKS = (
    ("rates", "S1 rates"),
    ("equity", "S2 shares and property"),
    ("currencies", "S3 currencies"),
    ("commodities", "S4 commodities"),
    ("credit", "S5 credit"),
    ("insurance", "S6 insurance"),
    ("active", "S10 active management"),
)
CAVEAT = (
    "The standard model with the present mix, on invested assets equal to the liability plus the"
    " required own funds; bonds that are not of kind credit bear no spread risk. S6 and S10 are the"
    " case's own shares."
)
RECOVERY = (
    "Recovery: the trained policy's paths with contributions, indexation and cuts by the plan's"
    " rules, against the required ratio of today."
)


def regulation(run: PensionRun) -> list[Block]:
    """Blocks of the reconciliation; none where the case names no rules."""
    found = run.get("reconciliation.regulation")
    if not found:
        return []
    policy = finite(found.get("policy_ratio")) or 0.0
    asked, least = (finite(found.get(k)) or 0.0 for k in ("required_ratio", "minimum_ratio"))
    state = "above the required ratio"
    if policy < asked:
        state = "in deficit: a recovery plan is needed"
    if policy < least:
        state = "below the minimum"
    facts = [
        ("Policy funding ratio", share(policy), state),
        ("Required funding ratio", share(asked), run.large(found.get("required")) + " own funds"),
        ("Minimum", share(least), run.large(found.get("minimum")) + " own funds"),
    ]
    blocks: list[Block] = [Facts(facts), _losses(run, found)]
    caveat = CAVEAT
    if (table := _recovery(run)) is not None:
        blocks.append(table)
        caveat = f"{CAVEAT} {RECOVERY}"
    source = f"Rules from {found.get('since')}: {found.get('source')}."
    return [*blocks, Text(caveat, caveat=True), Text(source, caveat=True)]


def _losses(run: PensionRun, found: dict) -> Table:
    losses = found["losses"]
    scale, unit = run.size(found.get("required"))
    rows = [(name, number((finite(losses.get(key)) or 0.0) / scale, 2)) for key, name in RISKS]
    rows.append(("Required own funds", number((finite(found["required"]) or 0.0) / scale, 2)))
    direction = "falling" if losses.get("falling") else "rising"
    caption = f"Losses by risk; for rates the worse scenario is that of {direction} ones"
    strong = frozenset([len(rows) - 1])
    return Table([("Risk", ""), ("Loss", unit)], rows, caption, 1, strong=strong)


def _recovery(run: PensionRun) -> Table | None:
    found = run.get("recovery")
    if not found:
        return None
    rows = [
        (str(year), share(each), share(median))
        for year, each, median in zip(found["years"], found["share"], found["median"])
    ]
    head = [("Year", ""), ("At the required ratio", "%"), ("Median policy ratio", "%")]
    caption = (
        "Recovery: the share of paths whose policy funding ratio is at least the required one;"
        f" a plan may take {number(found.get('allowed'), 0)} years"
    )
    return Table(head, rows, caption, 1)
