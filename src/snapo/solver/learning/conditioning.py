"""Adjoints that grow backwards in time: their record, and when to clip or to cut the horizon.

When to clip, and at which bound, is decided from the gradients of training and measured adjoints.

Most simulators need no clip, and it would bias their gradient. If derivatives explode backwards in
time, a few paths mislead training. The norms of the first gradients show this (see `is_chaotic`),
or a jump of one norm above all earlier ones, at no extra cost. Only then are the paths' adjoints
measured, with a memory of sqrt(T) steps, and bounded at the usual size of the largest on a path: a
larger adjoint comes from chaos, or from a policy that training is leaving. The rule does not depend
on units. If gradients were far larger than they are now, Adam's memory of them would keep its steps
small for the rest of the run, so this memory is reset.

The bound uses the largest adjoint of the whole horizon: where a plant settles, its last steps have
small adjoints, and a bound from them would remove the gradient of the approach. (Such a bound moved
the value of a quadrotor from -41.5 to -73; it is now -38.5.)

Once adjoints no longer grow backwards in time, the bound is lifted: those that are still far larger
than usual belong to important paths, such as those near ruin, and a rule trained with a bound on
them takes too much risk.

If the whole horizon is chaotic, training uses windows that are not (`learning.windows`).

On a chaotic horizon adjoints grow a hundredfold and more backwards in time, and differently on
every path, so that a few paths dominate all others: the gradient is noise, whatever the clipping.
On a plant that is merely unstable they grow equally on all paths. The norms of the first gradients
show the difference at no extra cost, since they jump up and down between steps in the chaotic case;
only then are the adjoints of some paths measured. A window is 1.5 times as long as the time over
which the largest adjoint stays near the usual one. The rule does not depend on units.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snapo.engine.norms import Norms, adjoint_norms
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

from ..statistics import rounded

FIRST = 20  # steps of training after which the norms are tested
ERRATIC = 0.3  # typical change of a norm's logarithm: below .15 on tame problems, above .4 in chaos
GROWTH = 100.0  # times that the adjoint grows from the last step to where it is largest
LEFT = 1 / 3  # of an adjoint after the steps in which it would grow so much
TAILS = 9.0  # largest of 256 paths to the usual one at a typical step: to 7 where tame, from 10 up
SPREAD = 10.0  # the same at the step up to which paths agree
LONGER = 1.5  # a window over that: without, 2 of a Pendulum's first 6 seeds failed
SHORTEST = 5
USUAL = 5  # of the first norms, and of the last ones, whose median counts
MANY = 64  # paths whose gradient has low noise
NormSeries = Sequence[float] | np.ndarray  # one norm for each step


def erratic(norms: Sequence[float], paths: int = MANY) -> bool:
    """Whether the norms of successive gradients, of `paths` paths each, jump up and down."""
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.abs(np.diff(np.log(np.asarray(norms, float))))
    # Few paths leave noise in the gradient of a tame problem too.
    limit = ERRATIC * max(1.0, MANY / paths) ** 0.5
    return bool(changes.size and np.median(changes) > limit)


def is_chaotic(norms: Sequence[float], paths: int = MANY) -> bool:
    """Whether the first gradients indicate chaos: they are erratic, or one of them fell far."""
    result = np.asarray(norms, float)
    return bool(np.any(result * GROWTH < np.maximum.accumulate(result))) or erratic(norms, paths)


def fell_for_good(norms: NormSeries) -> bool:
    """Whether gradients fell permanently: training leaves the chaotic region by itself."""
    result = np.asarray(norms, float)
    return bool(np.median(result[-USUAL:]) * GROWTH < np.median(result[:USUAL]))


def window_length(norms: np.ndarray) -> int | None:
    """The length of windows for adjoints of these norms [T, N]; None for the whole horizon."""
    norms = _finite(norms)
    usual = np.median(norms, axis=1)
    observed = usual > 0
    if not observed.any() or not grows(norms):
        return None
    tails = norms.max(1)[observed] / usual[observed]
    if not np.median(tails) > TAILS:
        return None
    return _agreeing(norms)


def grows(norms: np.ndarray) -> bool:
    """Whether adjoints of these norms [T, N] grow a hundredfold backwards in time."""
    size = np.sqrt(np.mean(_finite(norms) ** 2, axis=1))
    return bool(size[-1] * GROWTH < size.max())


def share_kept(norms: np.ndarray) -> float:
    """The share of an adjoint that is passed on at each backward step (`Clip.keep`), from norms [T,
    N]: a third is left after the number of steps in which norms grow a hundredfold; it is 1 if they
    do not. The reason for a third instead of 0.01: the value of a cart that swings its pole up is
    -63 to -66 with a third, -64 to -66 with 0.01 and -66 to -93 without either; that of a quadrotor
    is -37.9, -39.7 and -37.7.
    """
    back = np.sqrt(np.mean(_finite(norms) ** 2, axis=1))[::-1]
    over = np.flatnonzero(back > GROWTH * back[0])
    return float(LEFT ** (1 / over[0])) if over.size else 1.0


def _finite(norms: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(norms), norms, np.finfo(float).max ** 0.25)


def _agreeing(norms: np.ndarray) -> int | None:
    """The number of steps from the end after which paths no longer agree."""
    back = norms[::-1]
    usual = np.maximum(np.median(back, axis=1), np.finfo(float).tiny)
    apart = np.flatnonzero(back.max(1) > SPREAD * usual)
    length = max(SHORTEST, int(LONGER * apart[0]) if apart.size else len(back))
    return length if 2 * length <= len(back) else None


EARLY = 20  # steps after a beginning in which a fall of the norm counts
APART = 100.0  # times that a norm falls or leaps: more than a trained policy's first steps do
EVERY = 10  # steps between two measurements at first, later a tenth of all steps
HELD = 30.0  # times that all gradients exceed the last ones; with 10 noise is enough
PATHS = 256  # of a measurement: of 64 there may be none that chaos has caught
FEW = 64  # of a bound, which is a median


def has_fallen(norms: NormSeries, since: int, first: int = EARLY) -> bool:
    """Whether the last gradient is far below the largest of the `first` steps after `since`."""
    local = np.asarray(norms[since:])
    return 0 < len(local) <= first and bool(local[-1] * APART < local.max())


def has_leapt(norms: NormSeries, since: int) -> bool:
    """Whether the last gradient is far above the usual size of all earlier ones after `since`."""
    local = np.asarray(norms[since:])
    return len(local) > 3 and bool(local[-1] > APART * np.median(local[:-1]))


def is_held_down(norms: NormSeries, since: int, forget: float) -> bool:
    """Whether Adam's mean square of all gradients after `since`, with the decay `forget` per step,
    is far above the usual size of the last gradients; the steps of Adam are then too short by that
    factor."""
    local = np.asarray(norms[since:])
    if len(local) < 2 * EARLY:
        return False
    weights = forget ** np.arange(len(local))[::-1]
    return bool(np.median(local[-EARLY:]) * HELD < np.sqrt(np.average(local**2, weights=weights)))


def clip_level(norms: np.ndarray) -> float | None:
    """The bound for `engine.Clip` from norms [T, N] of a short memory; None if the usual path has
    no finite bound."""
    median = float(np.median(np.where(np.isfinite(norms), norms, np.inf).max(0)))
    return median if 0 < median < np.inf else None


def due(step: int) -> bool:
    """Whether it is time for another measurement: each costs as much as some steps of training."""
    return step % max(EVERY, EVERY * (step // (10 * EVERY))) == 0


def sampled_norms(
    problem: Problem,
    policy: Policy,
    smooth: Smooth,
    step: int,
    memory: int | None = None,
    paths: int = PATHS,
) -> Norms:
    """The norms of the adjoints of a few paths, for the mean of the objective's outputs."""
    draws = problem.sources.training.batch(step, paths, problem.simulator)
    weights = dict.fromkeys(problem.objective.outputs, np.full(draws.size, 1 / draws.size))
    return adjoint_norms(problem, policy, draws, smooth, weights, memory)


def short_memory_norms(problem: Problem, policy: Policy, smooth: Smooth, step: int) -> np.ndarray:
    """[T, N] of the whole state, with a memory of sqrt(T) steps."""
    memory = math.ceil(math.sqrt(problem.simulator.horizon))
    return sampled_norms(problem, policy, smooth, step, memory, FEW).total


TAME = 100.0  # times: less growth than this needs no word


class Growth(NamedTuple):
    """Norms of the adjoint before every step, on a few paths of training, for one policy.

    - `step`: the step of training at which they were measured.
    - `usual`, `largest`: [T] the median and the maximum over the paths.
    - `leaves`: {name: [T]} the root mean square over the paths, by part of the state.
    """

    step: int
    usual: tuple[float, ...]
    largest: tuple[float, ...]
    leaves: Mapping[str, tuple[float, ...]]

    @property
    def times(self) -> float:
        """The ratio of the largest adjoint to the one before the last step."""
        return max(self.largest) / max(self.largest[-1], np.finfo(float).tiny)

    @property
    def large(self) -> bool:
        """Whether the growth is at least a hundredfold, so that it must be reported and training
        considers windows or a bound. Adjoints that only add one payment per step grow by a factor
        equal to the number of steps."""
        return self.times > TAME

    def describe(self) -> str:
        """One sentence on their growth, with the step and the part of the state."""
        largest, times = np.asarray(self.largest), self.times
        position = int(np.argmax(largest))
        if not self.large:
            return f"Backward in time, adjoints grow {rounded(times, 3)}-fold, which is usual."
        half = _explodes(largest, position)
        state = max(self.leaves, key=lambda name: self.leaves[name][position], default="state")
        apart = largest[position] / max(self.usual[position], np.finfo(float).tiny)
        return (
            f"Backward in time, adjoints grow {rounded(times, 2)}-fold from the last step to step "
            f"{position} of {largest.size} (a hundredfold before step {half}), mainly in the "
            f"state {state!r}. At that step the largest adjoint of a path is {rounded(apart, 2)} "
            "times "
            "the typical one."
        )

    def table(self) -> list[tuple]:
        """Rows: the step, the usual and the largest norm, and that of every part of the state."""
        return list(zip(range(len(self.usual)), self.usual, self.largest, *self.leaves.values()))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns of `table`."""
        return ("step", "usual", "largest", *self.leaves)

    @classmethod
    def of(cls, norms: Norms, step: int) -> "Growth":
        """The record of norms that were measured at a step of training."""
        leaves = {name: _root_mean_square(leaf) for name, leaf in norms.leaves.items()}
        return cls(step, _row(np.median(norms.total, 1)), _row(norms.total.max(1)), leaves)

    @classmethod
    def read(cls, stored) -> "Growth | None":
        """The record from its plain data, as read from JSON."""
        if stored is None:
            return None
        step, usual, largest, leaves = stored
        leaves = {name: tuple(leaf) for name, leaf in leaves.items()}
        return cls(int(step), tuple(usual), tuple(largest), leaves)


def _explodes(largest: np.ndarray, position: int) -> int:
    """The step from which on adjoints, on their way back to `position`, exceed the limit."""
    over = largest[position:] > TAME * largest[-1]
    return position + int(np.flatnonzero(over)[-1])


def _root_mean_square(norms: np.ndarray) -> tuple[float, ...]:
    return _row(np.sqrt(np.mean(np.asarray(norms, float) ** 2, axis=1)))


def _row(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(float(f"{number:.6g}") for number in numbers)
