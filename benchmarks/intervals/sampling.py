"""`python -m benchmarks.intervals.sampling`: whether 95 % intervals contain what they estimate.

One trained policy of a small case is evaluated with 100 seeds. The program counts the intervals
that contain the policy's value on 4 million paths, and the same for one of its deltas.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from snapo.case.load import load
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.setup import case_of, make_setup
from snapo.problem.scenarios import Pseudo, Sources
from snapo.solver.evaluate import evaluate
from snapo.solver.sensitivity import sensitivities
from snapo.solver.solve import solve

CASE = Path(__file__).parents[1] / "tests" / "domains" / "gas_storage" / "cases" / "quick"
SEEDS, PATHS, MANY = 100, 4096, 4_194_304
DAY = 6  # whose forward price the delta belongs to
BLOCKS = 32
FIRST_STREAM = 1000  # far from those of training, validation and evaluation


class Trained:
    """One trained policy, and its value and delta on any scenarios."""

    def __init__(self):
        self.setup = make_setup(DOMAIN.read(*load(CASE)))
        problem, policy, training, evaluation, engines = self.setup
        self.curve = case_of(self.setup).market.forward_curve.name
        few = replace(evaluation, paths=1024, smooth_paths=0)
        options = {"training": training, "evaluation": few, "engine": engines}
        self.policy = solve(problem, policy, **options).policy

    def on(self, source: Pseudo):
        """The problem measured on other scenarios."""
        problem = self.setup.problem
        old = problem.sources
        return replace(problem, sources=Sources(old.training, old.validation, source))

    def value(self, source: Pseudo, paths: int) -> tuple[float, float]:
        """The value and its standard error, with the control variate."""
        engine = self.setup.engines.evaluate
        found = evaluate(self.on(source), self.policy, paths=paths, engine=engine)
        return found.value, found.standard_error

    def delta(self, source: Pseudo, paths: int) -> tuple[float, float]:
        """One held delta and its standard error from 32 blocks."""
        engine = self.setup.engines.evaluate
        found = sensitivities(self.on(source), self.policy, paths=paths, engine=engine).held[
            self.curve
        ]
        return float(found.value[DAY]), float(found.standard_error[DAY])


def hold(measure, truth: float, width: float) -> tuple[int, float]:
    """The number of seeds whose intervals contain the truth, and the mean standard error."""
    found = [measure(Pseudo(seed, stream=FIRST_STREAM), PATHS) for seed in range(SEEDS)]
    inside = [abs(value - truth) <= width * error for value, error in found]
    return sum(inside), float(np.mean([error for _, error in found]))


def main() -> None:
    trained, many = Trained(), Pseudo(SEEDS, stream=FIRST_STREAM)
    # The value's error comes from thousands of independent pairs, a delta's from 32 blocks.
    kinds = (
        ("value", trained.value, 1.96),
        ("delta", trained.delta, student.ppf(0.975, BLOCKS - 1)),
    )
    for name, measure, width in kinds:
        truth, error = measure(many, MANY)
        held, typical = hold(measure, truth, width)
        print(
            f"{name}: {held} of {SEEDS} intervals of {PATHS} paths contain {truth:.5f} ± "
            f"{error:.5f}, estimated on {MANY} paths; their mean standard error is {typical:.5f}"
        )


if __name__ == "__main__":
    main()
