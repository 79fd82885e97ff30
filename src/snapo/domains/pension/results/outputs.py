"""Sensitivities of several outputs in one run: the objective, and what a board asks for beside it.

Decisions are recorded once, and one adjoint pass with a cotangent for each output goes back over
the same paths. A share (of the funding ratio, of probability) is told in points and basis points,
and in money as that share of today's liability; money also as a share of it. A fund of personal
pots is told by its pensions over those of today, which have no such worth in money.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.inputs import plain
from snapo.problem.objective import CVaR, Mean, Objective, Probability
from snapo.solver.evaluate import estimate
from snapo.solver.sensitivity import held_of_several
from snapo.solver.statistics import Estimate
from snapo.study.study import StudyRun

from ..people.longer_life import longer_life
from .compare import equivalent
from .effects import LIFE, move
from .setup import Yardstick, case_of, yardstick

LEVEL = 0.95
WIDTH = 0.02  # of the ratio, over which a path counts as about to fall below the mark
PATHS = 4096
CSV = "outputs.csv"


class Output(NamedTuple):
    """A figure of the final ratio or of contributions.

    `value` and `error`: itself with its standard error; `held` {input: derivatives}, decisions
    held. `money`: whether it is money, else it is a share.
    """

    key: str
    name: str
    money: bool
    value: float
    error: float
    held: dict[str, Estimate]
    scale: float = 1.0


def asked(by: Yardstick) -> tuple[tuple[str, str, bool, Objective], ...]:
    """Key, name, whether it is money, the objective; underfunding is told as 1 less its
    complement."""
    return (
        ("funding", by.mean, False, Mean(by.output)),
        ("tail", by.tail, False, CVaR(by.output, LEVEL)),
        ("underfunded", by.below, False, -1.0 * Probability(by.output, 1.0, WIDTH)),
        ("contributions", "PV of contributions", True, Mean("pv_contribution")),
    )


def work(run: StudyRun) -> dict[str, Any]:
    """ "outputs": values of all outputs, and by input the effect of its usual move on each.

    `families` moves all numbers of an input, `rows` each number alone; `effects` {output: [effect,
    standard error]} in the output's own unit (money, or 1). Writes outputs.csv.
    """
    setup, solution = run.setup, run.solution
    table, liability = solution.sensitivities, run.get("liability")
    if table is None:
        return {"outputs": {}}
    every = list(_outputs(run))
    families, rows = [], []
    for name, given in table.inputs.items():
        usual = move(given)
        about = {"input": name, "move": usual.words, "group": given.group}
        said = about | {"count": given.value.size, "words": given.words}
        families.append(said | {"effects": _effects(every, name, usual.size)})
        for i, label in enumerate(given.names()):
            alone = np.where(np.arange(given.value.size) == i, usual.size, 0.0)
            rows.append(about | {"label": label, "effects": _effects(every, name, alone)})
    if (life := longer_life(case_of(run), plain(setup.problem.inputs))) is not None:
        said = {"input": "year_of_life", "move": "1 year", "group": "people", "words": LIFE}
        effects = _effects(every, life.input, life.change)
        families.append(said | {"count": len(life.change), "effects": effects})
    _write(run, every, rows, liability)
    known = [{k: v for k, v in o._asdict().items() if k not in ("held", "scale")} for o in every]
    return {"outputs": {"outputs": known, "families": families, "rows": rows}}


def _outputs(run: StudyRun) -> Iterator[Output]:
    """The objective first, whose derivatives the training left, then those of `asked`."""
    goals = asked(yardstick(case_of(run)))
    setup, solution, problem = run.setup, run.solution, run.setup.problem
    policy, table = solution.policy, solution.sensitivities
    assert policy is not None
    assert table is not None
    sure = equivalent(problem.objective, solution.value)
    value, slope = (solution.value, 1.0) if sure is None else (sure.ratio, sure.slope)
    name = "Objective" if sure is None else "Certainty equivalent"
    error = slope * solution.standard_error
    yield Output("objective", name, False, value, error, table.held, slope)
    totals = {name: np.asarray(total) for name, total in solution.totals.items()}
    paths = min(PATHS, setup.evaluation.sensitivity_paths, setup.evaluation.paths)
    run.tell(f"sensitivities of {len(goals)} more outputs at once")
    each = [goal for *_, goal in goals]
    table = held_of_several(problem, policy, each, paths=paths, engine=setup.engines.evaluate)
    for (key, name, money, goal), held in zip(goals, table):
        found = estimate(goal, totals, problem.sources.evaluation)
        value = found.value + (key == "underfunded")
        yield Output(key, name, money, value, found.standard_error, held)


def _effects(every: list[Output], name: str, size: np.ndarray) -> dict[str, list[float]]:
    """{output: [effect, standard error]} of a move [n] of an input's numbers."""
    found = {}
    for each in every:
        effect, error = each.held[name].along(size.reshape(each.held[name].value.shape))
        found[each.key] = [each.scale * effect, each.scale * error]
    return found


def _write(run: StudyRun, every: list[Output], rows: list[dict], liability: float | None) -> None:
    """Every number with its effect on every output, in points, basis points and money."""
    head = ("input", "label", "move", "output", "points", "points_error", "basis_points", "money")
    owed, valued = liability or float("nan"), case_of(run).pots is None

    def lines() -> Iterator[tuple]:
        for row in rows:
            for each in every:
                effect, error = row["effects"][each.key]
                share = 1 / owed if each.money else 1.0
                # A utility, unlike a certainty equivalent, is no share of anything.
                told = each.money or (valued and each.name != "Objective")
                money = share * effect * owed if told else float("nan")
                points = 100 * share * effect, 100 * share * error, 1e4 * share * effect
                yield row["input"], row["label"], row["move"], each.name, *points, money

    run.write_csv(CSV, head, lines())
