"""What the value gains or loses when an input moves by the amount that its owner has in mind."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from snapo.problem.inputs import Input
from snapo.solver.derivatives.bump import one_percent
from snapo.solver.derivatives.verdict import Verdict
from snapo.solver.sensitivity import Sensitivities
from snapo.solver.statistics import Estimate

from ..study import Part, StudyRun

SHARE = 0.01  # of every number of an input that does not say its `move`


def work(run: StudyRun) -> dict[str, Any]:
    """ "moves": one row per input, all of its numbers moved together, the largest effects first.

    - `amount`, `unit`: by how much every number moves, in the unit of its owner; `amount` is None
      where each moves by `share` of itself.
    - `effect`, `low`, `high`: the effect on the value to first order, with the reported derivative
      and its 95 % interval, of whose half-width `sampling` is due to finitely many paths and
      `policy` to the policy's error; `source`: where the derivative comes from, see
      `solver.derivatives.interval.Reported`. None where it is not known.
    - `held`, `held_error`: with the decisions held; `smooth`, `smooth_error`: through the policy's
      reaction; `bump`, `bump_error`: the change of the exact value that was seen, scaled to the
      size of this move, where it is along the same direction; `more`, `less`: of the move and of
      its opposite alone, where they differ.
    """
    table = run.solution.sensitivities
    if table is None:
        return {"moves": []}
    rows = [_row(name, given, table) for name, given in table.inputs.items()]
    return {"moves": sorted(rows, key=lambda row: -abs(row["effect"] or 0.0))}


MOVES = Part("moves", work, needs=("training",))


def direction(given: Input) -> np.ndarray:
    """How every number of an input moves, shaped like it."""
    if given.move is None:
        return SHARE * given.value
    return np.full(given.value.shape, given.move)


def interval(table: Sensitivities, name: str, along: np.ndarray) -> dict[str, float | None]:
    """The reported derivative along a direction as numbers of a table; None where not known."""
    names = ("effect", "low", "high", "sampling", "policy")
    numbers = table.along(name, along)
    return {key: float(x) if np.isfinite(x) else None for key, x in zip(names, numbers)}


def _row(name: str, given: Input, table: Sensitivities) -> dict[str, Any]:
    along = direction(given)
    bump = _bump(given, table.verdicts, name, along)
    beside = {
        "held": table.held[name].along(along),
        "smooth": _along(table.smooth, name, along),
        "bump": bump.bump if bump else (None, None),
    }
    return {
        "input": name,
        "words": given.words,
        "group": given.group,
        "numbers": given.value.size,
        "amount": None if given.move is None else given.move * given.trade_factor,
        "share": SHARE if given.move is None else None,
        "unit": given.trade_unit or given.unit,
        **interval(table, name, along),
        "source": table.source(name),
        **{key: value for key, (value, _) in beside.items()},
        **{f"{key}_error": error for key, (_, error) in beside.items()},
        "more": bump.up if bump and bump.two_sided else None,
        "less": bump.down if bump and bump.two_sided else None,
    }


def _bump(
    given: Input, verdicts: Mapping[str, Verdict] | None, name: str, along: np.ndarray
) -> Verdict | None:
    """The bump scaled to this move, where it has the same or the opposite direction."""
    verdict = (verdicts or {}).get(name)
    if verdict is None:
        return None
    by = one_percent(given)
    times = float(np.sum(along * by) / np.sum(by * by))
    if not np.allclose(along, times * by):
        return None
    up, down = (verdict.up, verdict.down) if times > 0 else (verdict.down, verdict.up)
    value, error = verdict.bump
    scaled = {"up": times * up, "down": times * down, "side_error": abs(times) * verdict.side_error}
    return verdict._replace(bump=(times * value, abs(times) * error), **scaled)


def _along(
    table: Mapping[str, Estimate] | None, name: str, along: np.ndarray
) -> tuple[float | None, float | None]:
    return (None, None) if table is None else table[name].along(along)
