"""`python -m benchmarks.intervals`: do 95 % intervals hold what they estimate?

One trained policy of a small case, evaluated with 100 seeds. How many of the intervals for its
value hold its value on 4 million paths, and the same for one of its deltas.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from snapo.domains.gas_storage.case import read_case
from snapo.domains.gas_storage.problem import make_problem, new_policy
from snapo.problem.scenarios import Pseudo
from snapo.problem.smooth import Exact
from snapo.solver import solve as solver
from snapo.solver.evaluate import estimate, path_totals
from snapo.solver.sensitivity import sensitivities

CASE = Path(__file__).parents[1] / "tests" / "domains" / "gas_storage" / "cases" / "quick"
SEEDS, PATHS, MANY = 100, 4096, 4_194_304
DAY = 6  # whose forward price the delta belongs to
BLOCKS = 32
FIRST_STREAM = 1000  # far from those of training, validation and evaluation


class Study:
    """One trained policy, and what it is worth on any scenarios."""

    def __init__(self):
        self.problem = make_problem(read_case(CASE), 0)
        solved = solver.solve(
            self.problem.simulator,
            self.problem.inputs,
            new_policy(self.problem),
            objective=self.problem.objective,
            training=self.problem.training,
            evaluation=replace(self.problem.evaluation, paths=1024, smooth_paths=0),
            engine=self.problem.engines,
        )
        self.policy = solved.policy

    def value(self, source: Pseudo, paths: int) -> tuple[float, float]:
        """The value and its standard error, with the control variate."""
        p = self.problem
        given = (p.engines.evaluate, p.simulator, self.policy, p.schedule, source, paths)
        totals = path_totals(*given, Exact())
        found = estimate(p.objective, totals, source, p.simulator.control_variates())
        return found.value, found.standard_error

    def delta(self, source: Pseudo, paths: int) -> tuple[float, float]:
        """One held delta and its standard error from 32 blocks."""
        p = self.problem
        given = (p.simulator, p.inputs, self.policy, p.objective, source, paths)
        found = sensitivities(*given, engine=p.engines.evaluate).held["forward_curve"]
        return float(found.value[DAY]), float(found.standard_error[DAY])


def hold(measure, truth: float, width: float) -> tuple[int, float]:
    """How many seeds' intervals hold the truth, and their mean standard error."""
    found = [measure(Pseudo(seed, stream=FIRST_STREAM), PATHS) for seed in range(SEEDS)]
    inside = [abs(value - truth) <= width * error for value, error in found]
    return sum(inside), float(np.mean([error for _, error in found]))


def main() -> None:
    study, many = Study(), Pseudo(SEEDS, stream=FIRST_STREAM)
    # The value's error comes from thousands of independent pairs, a delta's from 32 blocks.
    kinds = (("value", study.value, 1.96), ("delta", study.delta, student.ppf(0.975, BLOCKS - 1)))
    for name, measure, width in kinds:
        truth, error = measure(many, MANY)
        held, typical = hold(measure, truth, width)
        print(
            f"{name}: {held} of {SEEDS} intervals of {PATHS} paths hold {truth:.5f} ± {error:.5f} "
            f"(found on {MANY} paths); their standard error is {typical:.5f}"
        )


if __name__ == "__main__":
    main()
