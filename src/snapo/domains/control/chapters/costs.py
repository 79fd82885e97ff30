"""The parts of an episode's reward: the cost of each state and of each action."""

from snapo.report.folder import RunFiles
from snapo.report.missing import why_missing
from snapo.report.page import Section, Table
from snapo.report.quantity import decimals, measured, percent, readable
from snapo.report.rows import Bar, ladder
from snapo.study.chapters.distribution import DISTRIBUTION, OutputTotal
from snapo.study.study import LiveTable, PathTotals

ENDING = "_cost"  # of the names of outputs that are costs


def costs(run: RunFiles) -> Section:
    """A chart of the parts, and a table with their intervals."""
    title, short = "Cost by part", "Costs"
    result = DISTRIBUTION.of(run)
    totals = [x for x in result.distribution if _is_cost(x)] if result else []
    if not totals:
        return Section("costs", title, short, [why_missing(run, "distribution")])
    totals.sort(key=lambda total: -total.mean)
    digits = decimals([total.mean for total in totals], 4)
    complete = sum(total.mean for total in totals)
    bars = [Bar(_name(x.name), x.mean, x.standard_error) for x in totals]
    caption = "Mean cost of an episode under the trained policy, by part."
    rows = [
        (bar.name, *measured(bar.value, bar.error, digits),
         percent(bar.value / complete) if complete else "")
        for bar in bars
    ]  # fmt: skip
    head = [("Part", ""), ("Mean per episode", ""), ("", ""), ("Share", "")]
    blocks = [ladder("costs-ladder", bars, caption, digits), Table(head, rows, title)]
    return Section("costs", title, short, blocks)


def _is_cost(total: OutputTotal) -> bool:
    return total.paths > 0 and total.name.endswith(ENDING)


def _name(output: str) -> str:
    return readable(output.removesuffix(ENDING))


def reward_and_costs(measured: PathTotals) -> list[LiveTable]:
    """The live page's table: the reward, and the cost of every state and action."""
    names = [name for name in measured.totals if name.endswith(ENDING)]
    rows = [
        (f"cost of {_name(name).lower()}", *measured.mean(measured.totals[name])) for name in names
    ]
    rows.sort(key=lambda row: -row[1])
    columns = (("", ""), ("mean per episode", ""), ("±", ""))
    reward = ("reward", *measured.mean(measured.totals["reward"]))
    return [LiveTable("Reward and costs by part", columns, [reward, *rows])]
