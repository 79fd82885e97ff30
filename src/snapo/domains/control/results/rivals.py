"""Classical rules on the paths of the trained policy, and the closed form where it is known."""

from typing import Any

import numpy as np

from snapo.engine import Xla
from snapo.problem.inputs import plain
from snapo.solver.evaluate import path_totals, worth_of_groups
from snapo.solver.statistics import of_shares
from snapo.study.study import Part, StudyRun

from ..closed_form import optimum
from ..plants.plant import Plant
from ..rules import rivals


def rivals_part(plant: Plant) -> Part:
    """A part that gives "rivals", the best first, and "optimum", the closed form or None.

    A rival has a `name`, a `value`, and `less`: the trained policy's value less its own on the
    same paths, with the standard error of that difference, `less_error`.
    """

    def work(run: StudyRun) -> dict[str, Any]:
        problem = run.setup.problem
        source, objective = problem.sources.evaluation, problem.objective
        trained = worth_of_groups(objective, run.solution.totals, source)
        found = []
        for name, rule in rivals(plant, problem.inputs).items():
            # A rule is valued once: XLA compiles it faster than the native engine.
            totals = path_totals(
                problem, rule, run.solution.paths["evaluate"], engine=Xla(precision="float64")
            )
            shares = worth_of_groups(objective, totals, source)
            gap = of_shares(trained - shares)
            row = {"name": name, "value": float(np.mean(shares))}
            found.append(row | {"less": gap.value, "less_error": gap.standard_error})
        found.sort(key=lambda row: -row["value"])
        return {"rivals": found, "optimum": optimum(plant, plain(problem.inputs))}

    return Part("rivals", work, needs=("training",))
