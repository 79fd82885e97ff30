"""The same problem with several seeds: how much of a result is variation between trainings."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import PyTree

from snapo.problem.meant import problem_of
from snapo.problem.objective import Limit, Objective
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios, Sources
from snapo.problem.simulator import Simulator

from . import statistics
from .evaluate import value_of_groups
from .learning.progress import INTERRUPTED
from .learning.settings import Training
from .limits import Contender, best_first
from .solution import Solution
from .solve import Evaluation, in_order, solve


@dataclass(frozen=True, eq=False)
class Seeds:
    """Solutions by seed, all valued on the same paths, so that their values differ only by their
    policies.

    - `solutions`: {seed: solution}, in the requested order.
    - `best`: the seed with the highest value, among those within the limits of the problem if there
      are any (see `solver.limits.best_first`). It is the best of several on the same paths: a fresh
      evaluation of `solutions[best].policy` has no selection bias.
    """

    solutions: dict[int, Solution]

    @property
    def values(self) -> dict[int, float]:
        """{seed: value}."""
        return {seed: solution.value for seed, solution in self.solutions.items()}

    @property
    def best(self) -> int:
        return list(self.solutions)[best_first(list(self._contenders().values()))[0]]

    def _contenders(self) -> dict[int, Contender]:
        items = self.solutions.items()
        return {seed: Contender.of(item.value, item.constraints) for seed, item in items}

    def behind(self, seed: int) -> statistics.Sampled:
        """The difference between the best value and that of a seed, paired path by path."""
        one, other = self.solutions[self.best], self.solutions[seed]
        assert one.problem is not None
        objective, source = one.problem.objective, one.problem.sources.evaluation
        shares = [value_of_groups(objective, item.totals, source) for item in (one, other)]
        return statistics.of_shares(shares[0] - shares[1])

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        values = np.array(list(self.values.values()))
        spread = f", standard deviation {values.std(ddof=1):.3g}" if len(values) > 1 else ""
        lines = [
            f"{len(values)} seeds: {values.min():.6g} to {values.max():.6g}, "
            f"mean {values.mean():.6g}{spread}; ± is half of a 95 % interval"
        ]
        contenders = self._contenders()
        for seed, solution in self.solutions.items():
            behind = self.behind(seed)
            amount = statistics.rounded(abs(behind.value), 3)
            side = "above" if behind.value < 0 else "below"
            below = f"{amount} {statistics.plus_minus(behind.standard_error)} {side} the best"
            limits = "" if contenders[seed].within else ", limits not met"
            lines.append(
                f"  seed {seed}: {solution.value:.6g} "
                f"{statistics.plus_minus(solution.standard_error)}, "
                f"{'the best' if seed == self.best else below}{limits}; {solution.status}, "
                f"{solution.convergence}, "
                f"{solution.seconds['total']:.1f} s"
            )
        return "\n".join(lines)


def solve_seeds(
    problem: Problem | Simulator,
    inputs: PyTree = None,
    policy: Policy | eqx.Module | Solution | None = None,
    *,
    seeds: int | Iterable[int],
    objective: Objective | str | None = None,
    scenarios: Scenarios | Sources | None = None,
    constraints: Sequence[Limit] | Limit = (),
    training: Training | None = None,
    evaluation: Evaluation | None = None,
    **more: Any,
) -> Seeds:
    """Runs `solve` once for every seed; all seeds use the programs that were compiled for the
    first.

        found = snapo.solve_seeds(Reservoir(), inputs, objective="cash", seeds=5)
        print(found)

    A seed determines the initial weights, and the scenarios of training and validation, except
    `Supplied` ones. The scenarios of the evaluation are the same for all seeds: those of the
    problem or of the first seed.

    **Arguments:** `seeds`: the number of seeds, from `training.seed` on, or the seeds themselves;
    all other arguments are those of `solve`. After Ctrl-C during a training no further seed is
    trained.
    """
    if isinstance(problem, int) or not isinstance(seeds, int | Iterable):
        message = "the problem comes first, and seeds is a keyword: solve_seeds(problem, seeds=5)"
        raise ValueError(f"solve_seeds: {message}; got seeds={seeds!r}.")
    training, evaluation = training or Training(), evaluation or Evaluation()
    if isinstance(seeds, int):
        seeds = range(training.seed, training.seed + seeds)
    selected = tuple(seeds)
    if not selected or len(set(selected)) < len(selected):
        raise ValueError(
            f"solve_seeds: seeds is {selected}; there must be at least one seed, and no seed twice."
        )
    inputs, policy = in_order(problem, inputs, policy)
    values, sources = (inputs, objective, scenarios, constraints), evaluation.sources(selected[0])
    problem = problem_of("solve_seeds", problem, *values, sources=sources, seed=selected[0])
    table = {}
    for seed in selected:
        local = problem.on(problem.sources.reseeded(seed))
        settings = replace(training, seed=seed)
        table[seed] = solve(local, policy=policy, training=settings, evaluation=evaluation, **more)
        if table[seed].status == INTERRUPTED:
            break
    return Seeds(table)
