"""The trained policy beside classical rules, the closed form and Gymnasium's own environment."""

from snapo.report import charts
from snapo.report.drawing import draw
from snapo.report.folder import Folder
from snapo.report.page import Block, Chart, Section, Table, Text
from snapo.report.quantity import decimals, finite, measured, number, plus_minus
from snapo.report.sections.lacking import lacking

TITLE, SHORT = "Beside classical rules", "Rivals"


def rivals(run: Folder) -> Section:
    """A ladder of costs, and what the policy earns more than each rule on the same paths."""
    found = [each for each in run.get("rivals", []) if finite(each.get("value")) is not None]
    value = finite(run.result.get("value"))
    if not found or value is None:
        return Section("rivals", TITLE, SHORT, [lacking(run, "rivals")])
    error = finite(run.result.get("standard_error"))
    best = finite(run.get("optimum"))
    rows = [("trained policy", value, error, True)]
    if best is not None:
        rows.append(("optimum, in closed form", best, None, False))
    rows += [(each["name"], each["value"], None, False) for each in found]
    places = decimals([row[1] for row in rows], 5)
    rungs = [
        charts.Rung(name, reward, number(reward, places), wrong, strong)
        for name, reward, wrong, strong in sorted(rows, key=lambda row: -row[1])
    ]
    alt = "; ".join(f"{rung.name} {rung.text}" for rung in rungs)
    svg = draw("rivals-ladder", alt, lambda axes: charts.ladder(axes, rungs), 40 + 34 * len(rungs))
    blocks: list[Block] = [Chart(svg, "Mean reward of an episode; more is better.")]
    blocks.append(_table(found, places))
    blocks += _sentences(run, value, best)
    return Section("rivals", TITLE, SHORT, blocks)


def _table(found: list[dict], places: int) -> Table:
    head = [("Rule", ""), ("Reward", ""), ("Policy earns more", ""), ("", "")]
    rows = [
        (
            each["name"],
            number(each["value"], places),
            *measured(each["less"], each["less_error"], places, sign=True),
        )
        for each in found
    ]
    return Table(head, rows, "Classical rules on the policy's own paths")


def _sentences(run: Folder, value: float, best: float | None) -> list[Text]:
    texts = []
    if best is not None:
        share = 100 * (best - value) / abs(best) if best else 0.0
        texts.append(f"The policy costs {share:.2f} % more than the optimum in closed form.")
    real = run.get("gymnasium")
    if real:
        mean, error = number(real["mean"], 2), plus_minus(real["standard_error"], 2)
        starts = number(real["starts"], 0)
        texts.append(
            f"In Gymnasium's own {real['name']} it earns {mean} {error} over {starts} starts "
            "(reset with the seeds 0, 1, …)."
        )
    texts.append(
        "The linear regulator is Riccati's for the plant around its target, clipped to the limits."
    )
    return [Text(text) for text in texts]
