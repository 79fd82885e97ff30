"""Technical provisions, low dependency and buy-out side by side, and the recovery plan."""

from snapo.report.page import Block, Facts, Table, Text
from snapo.report.quantity import finite, number, percent

from .run import PensionRun, share

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
