"""Optimisation of a traceable function, with a test of its first-order conditions.

Sequential quadratic programming (SciPy's SLSQP) on exact derivatives of one compiled function
that has the goal and all constraints; without constraints L-BFGS-B. Its result is tested
separately: multipliers are fitted to the gradients at the solution.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import lsq_linear, minimize

from ..derivatives.mode import DERIVATIVES, Mode
from ..progress import say

SMALL = 1e-6  # a violation that counts as none when points are compared
TOLERANCE = 1e-6  # of the first-order conditions
ACTIVE = 1e-7  # a bound or inequality closer than this counts as active
# A few dozen calls: the compiler's last optimisations cost more than they save.
QUICK: dict[str, Any] = {"xla_backend_optimization_level": 1}
ROUNDS = 3  # a solver that stops short starts again from where it stopped


class Conditions(NamedTuple):
    """The Karush-Kuhn-Tucker conditions at a point, in variables scaled to 0..1.

    With f the goal to be minimised (minus the goal if it is maximised), grad f is the sum of
    non-negative multipliers times the gradients of the active constraints (x - low, high - x and
    the inequalities): relaxing one of these by one unit improves the goal by its multiplier.

    - `stationarity`: the largest entry of the residual of grad f with multipliers of the right
      sign; `violation`: the largest violation of a constraint. Both are relative: the goal is
      divided by `scale`.
    - `low`, `high`: [n] multipliers of the bounds; `equal` [k], `above` [m]: multipliers of the
      equalities (of any sign) and of the inequalities.
    """

    stationarity: float
    violation: float
    low: np.ndarray
    high: np.ndarray
    equal: np.ndarray
    above: np.ndarray

    @property
    def residual(self) -> float:
        return max(self.stationarity, self.violation)


class Recipe(NamedTuple):
    """The point `x` [n], the `value` and the `gradient` [n] there; the `conditions`, whose
    `residual` determines whether the search `converged`; `constraints` [k + m] at x; the work
    done; `message`: why the search stopped."""

    x: np.ndarray
    value: float
    gradient: np.ndarray
    conditions: Conditions
    constraints: np.ndarray
    iterations: int
    evaluations: int
    converged: bool
    message: str = ""

    @property
    def residual(self) -> float:
        return self.conditions.residual


class SearchLimits(NamedTuple):
    """The limits at which an optimisation stops; `progress` receives lines of progress, some
    seconds apart (by default the run that is in progress receives them)."""

    evaluations: int = 5000
    seconds: float = float("inf")
    progress: Callable[[str], None] = say


class Stopped(Exception):
    """An optimisation that ends before its solver does; its message is the reason."""


class TracedRecipe:
    """A traceable function of x [n] (and of further arguments) to [K] numbers, compiled once.

    A call returns the numbers and their derivative [K, n] with respect to x. The result of the last
    call is stored, since optimisers request values and derivatives one after the other.
    `compiling`: seconds.
    """

    def __init__(self, function: Callable, mode: Mode = "adjoint"):
        derivative = DERIVATIVES[mode]

        def both(x, *arguments):
            def twice(x):
                results = function(x, *arguments)
                return results, results

            slope, result = derivative(twice, has_aux=True)(x)
            return result, slope

        self._function, self._compiled = jax.jit(both), None
        self._key, self._found = None, (np.zeros(0), np.zeros(0))
        self.evaluations, self.compiling = 0, 0.0

    def compile(self, x, *arguments) -> None:
        """Compiles for arguments of these shapes."""
        started = time.perf_counter()
        with jax.enable_x64(True):
            lowered = self._function.lower(*_float64(x, *arguments))
            self._compiled = lowered.compile(compiler_options=QUICK)
        self.compiling += time.perf_counter() - started

    def __call__(self, x, *arguments) -> tuple[np.ndarray, np.ndarray]:
        values = _float64(x, *arguments)
        key = tuple(item.tobytes() for item in values)
        if key != self._key:
            if self._compiled is None:
                self.compile(x, *arguments)
            assert self._compiled is not None
            with jax.enable_x64(True):
                result = self._compiled(*values)
                self._found = np.asarray(result[0]), np.asarray(result[1])
            self._key = key
            self.evaluations += 1
        return self._found


class BestSoFar:
    """The evaluations of an optimisation so far."""

    def __init__(self, traced: TracedRecipe, limits: SearchLimits, equalities: int):
        self.traced, self.limits, self.equalities = traced, limits, equalities
        self.before, self.began = traced.evaluations, time.perf_counter()
        self._best: tuple[tuple[float, float], np.ndarray] | None = None
        self._last = -1

    def see(self, u: np.ndarray, values: np.ndarray, goal: float) -> None:
        """Records a point with its numbers; the first is the goal, with the sign for a minimum.

        **Raises:** `Stopped` at a limit, and if a number is non-finite.
        """
        count = self.traced.evaluations - self.before
        if count == self._last:  # the same point, asked for again
            return
        self._last = count
        if not np.isfinite(values).all():
            raise Stopped(
                f"the function is not a number after {count} evaluations, so the search stopped"
            )
        rest = values[1:]
        wrong = np.concatenate([[0.0], np.abs(rest[: self.equalities]), -rest[self.equalities :]])
        violation = float(wrong.max())
        rank = (violation if violation > SMALL else 0.0, float(values[0]))
        if self._best is None or rank < self._best[0]:
            self._best = rank, np.array(u)
        self.limits.progress(
            f"evaluation {count}: goal {float(goal):.7g}, largest violation {violation:.1e}"
        )
        if count >= self.limits.evaluations:
            raise Stopped(f"it stopped after {count} evaluations")
        taken = time.perf_counter() - self.began
        if taken >= self.limits.seconds:
            raise Stopped(f"it stopped after {taken:.0f} s")

    def best(self, start: np.ndarray) -> np.ndarray:
        """The best evaluated point, by the smallest violation, then by the goal; the start if there
        is none."""
        return start if self._best is None else self._best[1]


def _float64(*arrays) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(array, np.float64) for array in arrays)


def best(
    function: Callable,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    equality: Callable | None = None,
    inequality: Callable | None = None,
    sense: Literal[-1, 1] = 1,
    tolerance: float = TOLERANCE,
    limits: SearchLimits = SearchLimits(),
) -> Recipe:
    """Maximises the traceable `function(x)` (with `sense` -1: minimises it) within bounds, with
    `equality(x)` = 0 and `inequality(x)` >= 0 (arrays, of order one), to a `tolerance` of the
    first-order conditions. If the search ends before that, at one of the `limits` or because the
    function is NaN, the result is the best evaluated point, not `converged`, and `message` is the
    reason."""
    parts, count = [item for item in (function, equality, inequality) if item is not None], 0
    if equality is not None:
        with jax.enable_x64(True):
            count = jax.eval_shape(lambda x: jnp.ravel(equality(x)), *_float64(start)).size
    traced = TracedRecipe(lambda x: jnp.concatenate([jnp.ravel(part(x)) for part in parts]))
    return optimum(
        traced, start, low, high, equalities=count, sense=sense, tolerance=tolerance, limits=limits
    )


def optimum(
    traced: TracedRecipe,
    start: Sequence[float] | np.ndarray,
    low: Sequence[float] | np.ndarray,
    high: Sequence[float] | np.ndarray,
    arguments: tuple = (),
    equalities: int = 0,
    sense: Literal[-1, 1] = 1,
    scale: float = 1.0,
    tolerance: float = TOLERANCE,
    limits: SearchLimits = SearchLimits(),
) -> Recipe:
    """The best point of a function whose first number is the goal; the next `equalities` numbers
    must be 0, and all others at least 0. `scale`: the size of the goal; by default it is of order
    one."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    before = traced.evaluations
    monitor = BestSoFar(traced, limits, equalities)
    problem = _Scaled(traced, arguments, low, high, sense, scale, equalities, monitor)
    u, iterations = np.clip((np.asarray(start, float) - low) / (high - low), 0.0, 1.0), 0
    stopped = ""
    for _ in range(ROUNDS):
        try:
            u, steps = _solve(problem, u)
            iterations += steps
        except Stopped as stop:
            u, stopped = monitor.best(u), str(stop)
        conditions = problem.conditions(u)
        if stopped or conditions.residual <= tolerance:
            break
    converged = bool(conditions.residual <= tolerance)
    message = "converged" if converged else _short_of(conditions, tolerance, stopped)
    values, slopes = traced(low + (high - low) * u, *arguments)
    return Recipe(
        low + (high - low) * u,
        float(values[0]),
        slopes[0],
        conditions,
        values[1:],
        iterations,
        traced.evaluations - before,
        converged,
        message,
    )


def _short_of(conditions: Conditions, tolerance: float, stopped: str) -> str:
    """The reason why a point is not accepted as the optimum."""
    why = stopped or "the solver ended"
    return (
        f"{why} before the tolerance {tolerance:.1g} was reached: stationarity "
        f"{conditions.stationarity:.2g}, violation {conditions.violation:.2g}"
    )


class _Scaled(NamedTuple):
    """The problem in SciPy's form: a minimum, in variables u from 0 to 1."""

    traced: TracedRecipe
    arguments: tuple
    low: np.ndarray
    high: np.ndarray
    sense: int
    scale: float
    equalities: int
    best_so_far: BestSoFar

    def at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The scaled problem; the best point so far is recorded."""
        result = self.scaled(u)
        self.best_so_far.see(u, result[0], -self.sense * self.scale * result[0][0])
        return result

    def scaled(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers [K] and derivatives [K, n]; the goal with the sign for a minimum."""
        width = self.high - self.low
        values, slopes = self.traced(self.low + width * u, *self.arguments)
        sign = np.ones(len(values))
        sign[0] = -self.sense / self.scale
        return values * sign, slopes * sign[:, None] * width

    def conditions(self, u: np.ndarray) -> Conditions:
        """The conditions with multipliers by least squares; those of inequalities are not
        negative."""
        values, slopes = self.scaled(u)
        if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
            none, rest = np.full(len(u), np.nan), np.full(len(values) - 1, np.nan)
            few = slice(self.equalities), slice(self.equalities, None)
            return Conditions(np.inf, np.inf, none, none, *(rest[item] for item in few))
        n, k, width = len(u), self.equalities, self.high - self.low
        equal, above = values[1 : 1 + k], values[1 + k :]
        at_low, at_high = u <= ACTIVE, u >= 1 - ACTIVE
        tight = above <= ACTIVE
        rows = np.concatenate(
            [np.eye(n)[at_low], -np.eye(n)[at_high], slopes[1 : 1 + k], slopes[1 + k :][tight]]
        )
        minimum = np.zeros(len(rows))
        first = int(at_low.sum() + at_high.sum())
        minimum[first : first + k] = -np.inf
        result, rest = np.zeros(0), slopes[0]
        if len(rows):
            fit = lsq_linear(rows.T, slopes[0], (minimum, np.inf), method="bvls")
            result, rest = fit.x, fit.fun
        parts = np.split(result * self.scale, np.cumsum([at_low.sum(), at_high.sum(), k]))
        wrong = np.concatenate([[0.0], np.abs(equal), -above])
        return Conditions(
            float(np.max(np.abs(rest))),
            float(wrong.max()),
            _spread(parts[0], at_low) / width,
            _spread(parts[1], at_high) / width,
            parts[2],
            _spread(parts[3], tight),
        )


def _spread(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """A vector with the values at their positions, and zeros elsewhere."""
    spread = np.zeros(len(where))
    spread[where] = values
    return spread


def _solve(problem: _Scaled, u: np.ndarray) -> tuple[np.ndarray, int]:
    """One run of the solver: where it ended, and its iterations."""
    count, k = len(problem.at(u)[0]), problem.equalities
    ranges = [("eq", slice(1, 1 + k)), ("ineq", slice(1 + k, count))]
    constraints = [
        {"type": kind, "fun": lambda u, s=s: problem.at(u)[0][s],
         "jac": lambda u, s=s: problem.at(u)[1][s]}
        for kind, s in ranges if s.stop > s.start
    ]  # fmt: skip
    options: dict[str, Any] = {"maxiter": 500, "ftol": 1e-15}
    if not constraints:
        options |= {"gtol": 1e-10, "maxcor": 30, "maxfun": 5000}
    result = minimize(
        lambda u: float(problem.at(u)[0][0]),
        u,
        jac=lambda u: problem.at(u)[1][0],
        bounds=[(0.0, 1.0)] * len(u),
        constraints=constraints,
        method="SLSQP" if constraints else "L-BFGS-B",
        options=options,
    )
    return np.clip(result.x, 0.0, 1.0), int(result.nit)
