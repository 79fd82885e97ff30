"""Bounds on the value: the value of the policy from below, and perfect foresight with a penalty
from above."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from snapo.report.drawing import LIGHT, draw, number_axis
from snapo.report.folder import RunFiles
from snapo.report.page import Block, Chart, Section, Text
from snapo.report.quantity import decimals, finite, number, percent
from snapo.report.rows import Column, WithError, table
from snapo.solver import bound as solver
from snapo.solver.bound import Penalty

from ..chapter import Chapter, Number
from ..study import StudyRun

PATHS = 1024


@dataclass(frozen=True)
class BoundInterval:
    """A mean, its standard error, and its 95 % interval."""

    value: Number
    standard_error: Number
    low: Number
    high: Number


@dataclass(frozen=True)
class ValueBounds:
    """The numbers of a `snapo.Bound`; `lower` is the value of the run, and `upper` is this value
    plus the gap."""

    lower: BoundInterval
    upper: BoundInterval
    gap: BoundInterval
    penalty: str = ""
    words: str = ""
    scale: tuple[Number, ...] = ()
    paths: int = 0
    sure: tuple[float | None, float | None] = (None, None)
    few: bool = False
    says_little: str = ""

    @classmethod
    def of(cls, result: solver.Bound) -> "ValueBounds":
        """The numbers of a bound."""
        row = result.row()
        endpoints = {name: BoundInterval(**row.pop(name)) for name in ("lower", "upper", "gap")}
        return cls(**endpoints, **row)


def measure(run: StudyRun, paths: int = PATHS, penalty: Penalty = "value") -> ValueBounds:
    """The bounds of the run's value; the upper bound is never below the value that the run reports.

    **Raises:** `ValueError` if the study has no bound, with the reason.
    """
    relaxation, setup = run.study.relaxation, run.setup
    if isinstance(relaxation, str):
        raise ValueError(relaxation)
    policy = run.solution.policy
    if policy is None:
        raise ValueError("the run has no policy")
    result = solver.bound(
        setup.problem,
        policy,
        relaxation=relaxation(),
        paths=paths,
        penalty=penalty,
        engine=setup.engines.evaluate,
    )
    value, error = run.solution.value, run.solution.standard_error
    result = result.above(value, error, setup.problem.objective)
    run.progress(str(result))
    return ValueBounds.of(result)


def value_bounds(run: RunFiles) -> Section:
    """The section; for a run without bounds, a sentence on how to compute them."""
    section = BOUND(run)
    if BOUND.name in run.parts or BOUND.of(run) is not None:
        return section
    text = "This run has no upper bound on the value; `snapo certify` computes it."
    return replace(section, blocks=[Text(text)])


def optimum(run: RunFiles, cost: bool = False) -> str:
    """The bound as a sentence for the first screen; empty if there is no bound or it is too wide.

    `cost`: whether the value is minus a cost, so that the bound is a minimum cost.
    """
    result = BOUND.of(run)
    top = finite(result.upper.high) if result else None
    if result is None or top is None or result.says_little:
        return ""
    digits = decimals([result.gap.high], 2)
    text = run.value_text(-top if cost else top, None, max(0, digits))
    name = "Lowest possible cost: at least" if cost else "Optimum: at most"
    low = finite(result.lower.value)
    share = (
        f", {percent(result.gap.high / abs(low), 2)} away from the value of this policy"
        if low
        else ""
    )
    return f"{name} {text} (95 %){share}."


def show(run: RunFiles, result: ValueBounds) -> Sequence[Block]:
    """Shows the lower and upper bound with their 95 % intervals, and the gap between them in a
    sentence."""
    digits = decimals([result.upper.value], 6)
    rows = [("Trained policy", result.lower), ("Upper bound", result.upper)]
    columns = [
        Column("", lambda row: row[0]),
        Column("Value", lambda row: WithError(row[1].value, row[1].standard_error), run.unit),
    ]
    caption = f"On {number(result.paths, 0)} paths; ± is half of a 95 % interval"
    all_rows = [*rows, ("Gap, computed path by path", result.gap)]
    blocks: list[Block] = [
        Text(sentence(run, result, digits)),
        _chart(run, result, rows, digits),
        table(all_rows, columns, caption, folded="Bounds and gap", decimal_places=digits),
    ]
    low, high = result.sure
    if low is not None and high is not None:
        values = f"{number(low, decimals([low], 4))} and {number(high, decimals([high], 4))}"
        blocks.append(Text(f"As certainty equivalents, the two bounds are {values}."))
    return blocks


def sentence(run: RunFiles, result: ValueBounds, digits: int) -> str:
    """ "No policy earns more than EUR 78,498 …"."""
    top, gap, low = (finite(x) for x in (result.upper.high, result.gap.high, result.lower.value))
    if top is None or gap is None or low is None:
        return "There are too few paths for an interval."
    if small := result.says_little:
        return f"This bound {small}. No policy earns more than {run.value_text(top, None, digits)}."
    share = f", {percent(gap / abs(low), 2)} of its value" if low else ""
    return (
        f"No policy earns more than {run.value_text(top, None, digits)}: the best policy earns at "
        f"most {run.value_text(gap, None, digits)} more than the trained policy{share} (95 % "
        f"intervals)."
    )


def _chart(
    run: RunFiles, result: ValueBounds, rows: Sequence[tuple[str, BoundInterval]], digits: int
) -> Chart:
    exact = finite(run.get("dynamic_programming"))
    texts = "; ".join(
        f"{name}: {number(x.value, digits)}, {number(x.low, digits)} to {number(x.high, digits)}"
        for name, x in rows
    )

    def paint(axes) -> None:
        for row, (_, x) in enumerate(rows):
            colour = LIGHT["main"] if row == 0 else LIGHT["withdraw"]
            error = [[x.value - x.low], [x.high - x.value]]
            style = {"fmt": "o", "color": colour, "ecolor": colour, "capsize": 5.0}
            axes.errorbar([x.value], [row], xerr=error, elinewidth=2.0, **style)
        if exact is not None:
            axes.axvline(exact, color=LIGHT["other"], linestyle="--")
            axes.text(exact, -0.5, " exact", color=LIGHT["muted"], va="center")
        axes.set_yticks(range(len(rows)), [name for name, _ in rows])
        axes.set_ylim(len(rows) - 0.4, -0.7)
        axes.grid(axis="x")
        axes.margins(x=0.1)
        number_axis(axes.xaxis)
        axes.set_xlabel(run.unit)

    svg = draw("bounds", f"Two points with 95 % intervals. {texts}.", paint, 120)
    caption = (
        "The upper bound is the value plus the gap. The gap is the mean over fresh paths of the "
        "earnings of the best decisions with perfect foresight, less a penalty for foresight, "
        "minus the earnings of the policy. For policies without foresight, the penalty has mean "
        f"zero ({result.words})."
    )
    return Chart(svg, caption)


BOUND = Chapter(
    "bound", "Bounds: how far is the policy from the best one?", ValueBounds, measure, show,
    short="Bounds", key="bound",
)  # fmt: skip
