"""Shadow prices: the worth of one unit more, and of one unit less, of each capacity.

At a limit the two differ: an inventory that is exactly full can use more room and must give up
room that is taken away. Both come from the exact simulator with the decisions held, on the same
paths, one unit up and one unit down.
"""

from typing import Any

import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact
from snapo.study.study import Part, Setup, StudyRun

from ..setup import OUTPUT, beside, case_of, policy_of

PATHS = 2048
UNITS = 1.0  # of the capacity; small against it, large against rounding


def work(run: StudyRun) -> dict[str, Any]:
    """One line per capacity: the worth of one unit more (`up`) and of the last unit (`down`)."""
    case = case_of(run.setup)
    contract, units = case.contract, case.volume_unit
    rows = contract.ratchets
    wanted = [
        ("working volume", contract.max_inventory.name, units),
        ("injection capacity", rows.injection.name, f"{units}/day"),
        ("withdrawal capacity", rows.withdrawal.name, f"{units}/day"),
        ("gas in store today", contract.inventory.name, units),
    ]
    replay = _Replay(run.setup, policy_of(run.solution))
    base = replay.value({})
    lines = []
    for name, key, unit in wanted:
        up, down = (replay.value({key: sign * UNITS}) for sign in (1, -1))
        worth = {"up": (up - base) / UNITS, "down": (base - down) / UNITS}
        lines.append({"name": name, **worth, "unit": unit})
    return {"shadow_prices": lines}


SHADOW_PRICES = Part("shadow prices", work, needs=("training",))


class _Replay:
    """Values of the exact simulator under recorded decisions, with inputs shifted."""

    def __init__(self, setup: Setup, policy: Policy):
        self.problem, self.engine = beside(setup), setup.engines.evaluate
        source = self.problem.sources.evaluation
        bound = self.engine.bind(self.problem)
        paths = source.available(PATHS)
        blocks = source.blocks(paths, max(1, paths // 512))
        self.draws = [source.draws(block, self.problem.simulator) for block in blocks]
        self.actions = [
            bound.values(policy, draws, Exact(), record=("action",)).record["action"]
            for draws in self.draws
        ]

    def value(self, shifts: dict[str, float]) -> float:
        """The mean cash flow with all entries of these inputs shifted; NaN if not feasible."""
        named = self.problem.named
        values = {name: named[name].value + shift for name, shift in shifts.items()}
        if any(np.any(value < 0) for value in values.values()):
            return float("nan")
        moved = self.problem.at(values)
        if np.any(moved.schedule.steps.low > moved.schedule.steps.high):
            return float("nan")
        bound = self.engine.bind(moved, controls=False)
        totals = [
            bound.values(None, draws, Exact(), actions=actions).totals[OUTPUT]
            for draws, actions in zip(self.draws, self.actions)
        ]
        return float(np.mean([np.mean(total) for total in totals]))
