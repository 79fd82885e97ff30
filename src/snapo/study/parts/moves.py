"""What the value gains or loses when an input moves by the amount that its owner has in mind."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from snapo.problem.inputs import Input
from snapo.solver.judge import UNKNOWN, Verdict, hundredth
from snapo.solver.sensitivity import Sensitivities
from snapo.solver.statistics import Estimate

from ..study import Part, StudyRun

SHARE = 0.01  # of every number of an input that does not say its `move`


def work(run: StudyRun) -> dict[str, Any]:
    """ "moves": one row per input, all of its numbers moved together, the largest effects first.

    - `amount`, `unit`: by how much every number moves, in the unit of its owner; `amount` is None
      where each moves by `share` of itself.
    - `held`, `held_error`: the effect on the value, to first order, with the decisions held;
      `smooth`, `smooth_error`: through the policy's reaction.
    - `believed`: which of the two a move by a hundredth supports, "held" or "smooth", or "not
      known" ("" where none was made); `tried`, `tried_error`: the change of the exact value that
      was seen, scaled to the size of this move, where it is along the same direction; `more`,
      `less`: of the move and of its opposite alone, where they differ.
    - `effect`, `standard_error`: the believed one; where neither is, the one that was tried.
    """
    table = run.solution.sensitivities
    if table is None:
        return {"moves": []}
    rows = [_row(name, given, table) for name, given in table.inputs.items()]
    return {"moves": sorted(rows, key=lambda row: -abs(row["effect"]))}


MOVES = Part("moves", work, needs=("training",))


def direction(given: Input) -> np.ndarray:
    """How every number of an input moves, shaped like it."""
    if given.move is None:
        return SHARE * given.value
    return np.full(given.value.shape, given.move)


def _row(name: str, given: Input, table: Sensitivities) -> dict[str, Any]:
    along = direction(given)
    tried = _tried(given, table.verdicts, name, along)
    found = {
        "held": table.held[name].along(along),
        "smooth": _along(table.smooth, name, along),
        "tried": (tried.change, tried.error) if tried else (None, None),
    }
    believed = table.believed(name)
    chosen = believed or "held"
    if chosen == UNKNOWN:
        chosen = "held" if found["tried"][0] is None else "tried"
    effect, error = found[chosen]
    return {
        "input": name,
        "words": given.words,
        "group": given.group,
        "numbers": given.value.size,
        "amount": None if given.move is None else given.move * given.trade_factor,
        "share": SHARE if given.move is None else None,
        "unit": given.trade_unit or given.unit,
        "effect": effect,
        "standard_error": error,
        "believed": believed,
        **{name: value for name, (value, _) in found.items()},
        **{f"{name}_error": error for name, (_, error) in found.items()},
        "more": tried.up if tried and tried.two_sided else None,
        "less": tried.down if tried and tried.two_sided else None,
    }


def _tried(
    given: Input, verdicts: Mapping[str, Verdict] | None, name: str, along: np.ndarray
) -> Verdict | None:
    """The judging move scaled to this one, where it has the same or the opposite direction."""
    found = (verdicts or {}).get(name)
    if found is None:
        return None
    by = hundredth(given)
    times = float(np.sum(along * by) / np.sum(by * by))
    if not np.allclose(along, times * by):
        return None
    up, down = (found.up, found.down) if times > 0 else (found.down, found.up)
    return found._replace(up=times * up, down=times * down, error=abs(times) * found.error)


def _along(
    found: Mapping[str, Estimate] | None, name: str, along: np.ndarray
) -> tuple[float | None, float | None]:
    return (None, None) if found is None else found[name].along(along)
