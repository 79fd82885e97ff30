"""When to clip, and at which bound: from gradients as they come, and adjoints as they are measured.

Most simulators need no clip, and it would bend their gradient. Where the derivative explodes on
its way back, a few paths lead training astray. That shows in the norms of the first gradients (see
`horizon.wild`), or in a leap of one norm over all before it, and costs nothing to see. Only then
the paths' adjoints are measured, with a memory of sqrt(T) steps, and bounded at the usual size of
the largest on a path: an adjoint that has grown beyond it is that of chaos, or of a policy that is
being left behind. No unit enters. Where gradients were far larger than they are now, Adam's memory
of them would hold its steps down for the rest of the run: it forgets them.

It is the largest of the whole horizon: where a plant comes to rest, its last steps have small
adjoints, and a bound from them cuts off what the way there teaches. (A quadrotor at -41.5 climbed
down to -73 so, and ends at -38.5 now.)

Once adjoints do not grow on their way back any more, the bound is lifted: those that are still far
larger than the usual one belong to paths that matter, such as those near ruin, and a rule trained
with a bound on them takes too much risk.
"""

import math
from collections.abc import Sequence

import numpy as np

from snapo.engine.norms import Norms, adjoint_norms
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

FIRST = 20  # steps after a beginning in which a fall of the norm counts
APART = 100.0  # times that a norm falls or leaps: more than a trained policy's first steps do
EVERY = 10  # steps between two measurements at first, later a tenth of all steps
HELD = 30.0  # times that all gradients exceed the last ones; with 10 noise alone is enough
PATHS = 256  # of a measurement: of 64 there may be none that chaos has caught
FEW = 64  # of a bound, which is a median


def fell(norms: Sequence[float], since: int, first: int = FIRST) -> bool:
    """Whether the last gradient is far below the largest of the `first` steps after `since`."""
    local = np.asarray(norms[since:])
    return 0 < len(local) <= first and bool(local[-1] * APART < local.max())


def leapt(norms: Sequence[float], since: int) -> bool:
    """Whether the last gradient is far above the usual one of all before it, after `since`."""
    local = np.asarray(norms[since:])
    return len(local) > 3 and bool(local[-1] > APART * np.median(local[:-1]))


def held_down(norms: Sequence[float], since: int, forget: float) -> bool:
    """Whether Adam's mean square of all gradients after `since`, of which it keeps a share `forget`
    a step, is far above the usual size of the last ones: its steps are as many times too short."""
    local = np.asarray(norms[since:])
    if len(local) < 2 * FIRST:
        return False
    weights = forget ** np.arange(len(local))[::-1]
    return bool(np.median(local[-FIRST:]) * HELD < np.sqrt(np.average(local**2, weights=weights)))


def clip_level(norms: np.ndarray) -> float | None:
    """The bound for `engine.Clip` from norms [T, N] of a short memory; None where the usual path
    has none that is finite."""
    median = float(np.median(np.where(np.isfinite(norms), norms, np.inf).max(0)))
    return median if 0 < median < np.inf else None


def due(step: int) -> bool:
    """Whether it is time for another measurement: each costs as much as some steps of training."""
    return step % max(EVERY, EVERY * (step // (10 * EVERY))) == 0


def measured(
    problem: Problem,
    policy: Policy,
    smooth: Smooth,
    step: int,
    memory: int | None = None,
    paths: int = PATHS,
) -> Norms:
    """How large the adjoints of a few paths are, for the mean of the objective's outputs."""
    draws = problem.sources.training.batch(step, paths, problem.simulator)
    weights = dict.fromkeys(problem.objective.outputs, np.full(draws.size, 1 / draws.size))
    return adjoint_norms(problem, policy, draws, smooth, weights, memory)


def short(problem: Problem, policy: Policy, smooth: Smooth, step: int) -> np.ndarray:
    """[T, N] of the whole state, with a memory of sqrt(T) steps."""
    memory = math.ceil(math.sqrt(problem.simulator.horizon))
    return measured(problem, policy, smooth, step, memory, FEW).total
