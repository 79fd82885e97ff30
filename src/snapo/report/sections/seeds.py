"""Several trainings of one case: how much of the result is the luck of a seed."""

from typing import Any

from .. import charts
from ..drawing import draw, unit_above
from ..folder import Folder
from ..page import Chart, Section, Table, Text
from ..quantity import decimals, finite, measured, number, seconds
from ..theme import LIGHT

MOST = 40  # seeds in the picture; all stand in the table


def seeds(run: Folder) -> Section:
    """The value of every seed with its interval, and the spread beside the Monte Carlo error."""
    found = run.get("by_seed")
    errors = [finite(found.get(name)) for name in ("standard_error", "deviation")]
    values = [row["value"] for row in found["rows"]]
    places = decimals([each for each in errors if each] or values, 2)
    table = _table(found, places)
    shown = [row for row in found["rows"] if finite(row["value"]) is not None][:MOST]
    blocks: list[Any] = [Text(_sentence(found, run.unit, places)), table]
    if len(shown) > 1:
        blocks.insert(1, _picture(found, shown, run.unit, places))
    return Section("seeds", "Between seeds", "Seeds", blocks)


def _sentence(found: dict[str, Any], unit: str, places: int) -> str:
    mean, worst, best = (number(found[name], places) for name in ("mean", "worst", "highest"))
    spread, error = (number(found[name], places) for name in ("deviation", "standard_error"))
    paths = number(found["paths"], 0)
    text = (
        f"The case was trained with {len(found['rows'])} seeds. On {paths} paths that all of them "
        f"share they are worth {mean} {unit} on average, {worst} at worst and {best} at best"
    ).replace("  ", " ")
    if finite(found["deviation"]) is not None:
        text += (
            f"; their standard deviation is {spread}, and the Monte Carlo error of these paths, "
            f"the same for all, {error}"
        )
    return f"{text}. This page is the run of seed {found['best']}."


def _picture(found: dict[str, Any], shown: list[dict[str, Any]], unit: str, places: int) -> Chart:
    """Differences to the best, which are known far better than the values themselves."""
    names = [str(row["seed"]) for row in shown]
    below = [-row["below_best"] for row in shown]
    errors = [charts.INTERVAL * (finite(row["below_best_error"]) or 0.0) for row in shown]

    def paint(axes, _=None):
        line = {"ecolor": LIGHT["withdraw"], "elinewidth": 1.6, "capsize": 4.0}
        axes.errorbar(range(len(shown)), below, yerr=errors, fmt="o", color=LIGHT["main"], **line)
        axes.axhline(0.0, color=LIGHT["other"], linewidth=0.8)
        axes.set_xticks(range(len(shown)), names)
        axes.set_xlim(-0.6, len(shown) - 0.4)
        axes.set_xlabel("Seed")
        unit_above(axes, unit)

    told = "; ".join(f"seed {name} {number(each, places)}" for name, each in zip(names, below))
    caption = (
        "What the policy of each seed is worth less than the best one, path by path on common "
        "paths, with 95 % intervals."
    )
    return Chart(draw("seeds-picture", f"Difference to the best: {told}.", paint, 220), caption)


def _table(found: dict[str, Any], places: int) -> Table:
    head = [
        ("Seed", ""), ("Verdict", ""), ("Value", ""), ("", ""), ("Below the best", ""), ("", ""),
        ("Time", ""),
    ]  # fmt: skip
    rows = []
    for row in found["rows"]:
        best = row["seed"] == found["best"]
        verdict = [row["status"], row["convergence"], "" if row["within"] else "breaks a limit"]
        below = ("the best", "") if best else (row["below_best"], row["below_best_error"])
        rows.append(
            (
                str(row["seed"]),
                ", ".join(filter(None, verdict)),
                *measured(row["value"], row["standard_error"], places),
                *(below if best else measured(*below, places)),
                seconds(row["seconds"]),
            )
        )
    chosen = frozenset(i for i, row in enumerate(found["rows"]) if row["seed"] == found["best"])
    return Table(head, rows, "Seeds on common paths", 2, chosen)
