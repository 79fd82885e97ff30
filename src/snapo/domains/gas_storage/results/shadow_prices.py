"""Shadow prices: the worth of one unit more, and of one unit less, of each capacity.

At a limit the two differ: an inventory that is exactly full can use more room and must give up
room that is taken away. Both come from the exact simulator with the decisions held, on the same
paths, one unit up and one unit down.
"""

from typing import Any

import equinox as eqx
import numpy as np

from snapo.problem.policy import Policy
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Scenarios
from snapo.problem.smooth import Exact

from ..problem import OUTPUT, Problem

PATHS = 2048
UNITS = 1.0  # of the capacity; small against it, large against rounding


def shadow_prices(problem: Problem, policy: Policy, source: Scenarios) -> list[dict[str, Any]]:
    """One line per capacity: the worth of one unit more (`up`) and of the last unit (`down`)."""
    contract, units = problem.case.contract, problem.case.volume_unit
    rows = contract.ratchets
    wanted = [
        ("working volume", contract.max_inventory.name, units),
        ("injection capacity", rows.injection.name, f"{units}/day"),
        ("withdrawal capacity", rows.withdrawal.name, f"{units}/day"),
        ("gas in store today", contract.inventory.name, units),
    ]
    replay = _Replay(problem, policy, source)
    base = replay.value({})
    lines = []
    for name, key, unit in wanted:
        up, down = (replay.value({key: sign * UNITS}) for sign in (1, -1))
        lines.append(
            {"name": name, "up": (up - base) / UNITS, "down": (base - down) / UNITS, "unit": unit}
        )
    return lines


class _Replay:
    """Values of the exact simulator under recorded decisions, with inputs shifted."""

    def __init__(self, problem: Problem, policy: Policy, source: Scenarios):
        self.problem = problem
        paths = problem.case.model.paths(PATHS)
        self.blocks = [
            source.draws(b, problem.simulator) for b in source.blocks(paths, max(1, paths // 512))
        ]
        self.engine = problem.engines.evaluate
        given = (problem.simulator, policy, problem.schedule)
        self.actions = [
            self.engine.values(*given, draws, Exact(), record=("action",)).record["action"]
            for draws in self.blocks
        ]

    def value(self, shifts: dict[str, float]) -> float:
        """The mean cash flow with all entries of these inputs shifted; NaN if not feasible."""
        inputs = dict(self.problem.inputs)
        for name, shift in shifts.items():
            moved = inputs[name].value + shift
            if np.any(moved < 0):
                return float("nan")
            inputs[name] = eqx.tree_at(lambda i: i.value, inputs[name], moved)
        schedule = prepare(self.problem.simulator, inputs)
        if np.any(schedule.steps.low > schedule.steps.high):
            return float("nan")
        totals = [
            self.engine.values(
                self.problem.simulator, None, schedule, draws, Exact(), actions=actions
            ).totals[OUTPUT]
            for draws, actions in zip(self.blocks, self.actions)
        ]
        return float(np.mean([np.mean(t) for t in totals]))
