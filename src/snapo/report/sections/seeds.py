"""Several trainings of one case: how much of the result is the luck of a seed."""

from typing import Any

from .. import charts
from ..drawing import draw, unit_above
from ..folder import RunFiles
from ..page import Chart, Section, Table, Text
from ..quantity import decimals, finite, measured, number, seconds
from ..theme import LIGHT

MAXIMUM = 40  # seeds in the picture; all stand in the table


def seeds(run: RunFiles) -> Section:
    """The value of every seed with its interval, and the spread beside the Monte Carlo error."""
    result = run.get("by_seed")
    errors = [finite(result.get(name)) for name in ("standard_error", "deviation")]
    values = [row["value"] for row in result["rows"]]
    digits = decimals([error for error in errors if error] or values, 2)
    table = _table(result, digits)
    displayed = [row for row in result["rows"] if finite(row["value"]) is not None][:MAXIMUM]
    blocks: list[Any] = [Text(_sentence(result, run.unit, digits)), table]
    if len(displayed) > 1:
        blocks.insert(1, _picture(result, displayed, run.unit, digits))
    return Section("seeds", "Between seeds", "Seeds", blocks)


def _sentence(result: dict[str, Any], unit: str, digits: int) -> str:
    mean, worst, best = (number(result[name], digits) for name in ("mean", "worst", "highest"))
    spread, error = (number(result[name], digits) for name in ("deviation", "standard_error"))
    paths = number(result["paths"], 0)
    text = (
        f"The case was trained with {len(result['rows'])} seeds. On {paths} paths that all of them "
        f"share they are worth {mean} {unit} on average, {worst} at worst and {best} at best"
    ).replace("  ", " ")
    if finite(result["deviation"]) is not None:
        text += (
            f"; their standard deviation is {spread}, and the Monte Carlo error of these paths, "
            f"the same for all, {error}"
        )
    return f"{text}. This page is the run of seed {result['best']}."


def _picture(
    result: dict[str, Any], displayed: list[dict[str, Any]], unit: str, digits: int
) -> Chart:
    """Differences to the best, which are known far better than the values themselves."""
    names = [str(row["seed"]) for row in displayed]
    below = [-row["below_best"] for row in displayed]
    errors = [charts.INTERVAL * (finite(row["below_best_error"]) or 0.0) for row in displayed]

    def paint(axes, _=None):
        line = {"ecolor": LIGHT["withdraw"], "elinewidth": 1.6, "capsize": 4.0}
        axes.errorbar(
            range(len(displayed)), below, yerr=errors, fmt="o", color=LIGHT["main"], **line
        )
        axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
        axes.set_xticks(range(len(displayed)), names)
        axes.set_xlim(-0.6, len(displayed) - 0.4)
        axes.set_xlabel("Seed")
        unit_above(axes, unit)

    summary = "; ".join(f"seed {name} {number(item, digits)}" for name, item in zip(names, below))
    caption = (
        "What the policy of each seed is worth less than the best one, path by path on common "
        "paths, with 95 % intervals."
    )
    return Chart(draw("seeds-picture", f"Difference to the best: {summary}.", paint, 220), caption)


def _table(result: dict[str, Any], digits: int) -> Table:
    head = [
        ("Seed", ""), ("Verdict", ""), ("Value", ""), ("", ""), ("Below the best", ""), ("", ""),
        ("Time", ""),
    ]  # fmt: skip
    rows = []
    for row in result["rows"]:
        best = row["seed"] == result["best"]
        verdict = [row["status"], row["convergence"], "" if row["within"] else "breaks a limit"]
        below = ("the best", "") if best else (row["below_best"], row["below_best_error"])
        rows.append(
            (
                str(row["seed"]),
                ", ".join(filter(None, verdict)),
                *measured(row["value"], row["standard_error"], digits),
                *(below if best else measured(*below, digits)),
                seconds(row["seconds"]),
            )
        )
    selected = frozenset(i for i, row in enumerate(result["rows"]) if row["seed"] == result["best"])
    return Table(head, rows, "Seeds on common paths", 2, selected)
