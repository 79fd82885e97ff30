"""The best open-loop recipe: gradient-based optimisation with its first-order conditions."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import lsq_linear, minimize

from .process import Entry, Process

TOLERANCE = 1e-6  # of the first-order conditions


class Recipe(NamedTuple):
    """`x` [n] and the `value` there; `gradient` [n]; `residual`: of the first-order conditions,
    in variables scaled to 0..1 and relative to the larger of 1 and |value|."""

    x: np.ndarray
    value: float
    gradient: np.ndarray
    residual: float
    iterations: int
    converged: bool


class _Scaled:
    """A traceable function of x as one of u = (x - low) / (high - low), with its derivative."""

    def __init__(self, function: Callable, low: np.ndarray, high: np.ndarray):
        self.low, self.width = low, high - low

        def both(u):
            def of_u(u):
                found = function(self.low + self.width * u)
                return found, found

            derivative = jax.jacrev(of_u, has_aux=True)
            slope, value = derivative(u)
            return value, slope

        self._both, self._at, self._found = jax.jit(both), None, None

    def _all(self, u: np.ndarray):
        """Value and derivative, of which the optimiser asks one after the other."""
        if self._at is None or not np.array_equal(u, self._at):
            with jax.enable_x64(True):
                self._found = tuple(np.asarray(each) for each in self._both(u))
            self._at = np.array(u)
        assert self._found is not None
        return self._found

    def value(self, u: np.ndarray):
        return self._all(u)[0]

    def slope(self, u: np.ndarray):
        return self._all(u)[1]


def best(
    function: Callable,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    equality: Callable | None = None,
    inequality: Callable | None = None,
    sense: int = 1,
) -> Recipe:
    """Makes the traceable `function(x)` large (`sense` -1: small) within bounds, with
    `equality(x)` = 0 and `inequality(x)` >= 0 (arrays, of order one).

    Sequential quadratic programming (SLSQP) with exact gradients; without constraints L-BFGS-B.
    """
    start, low, high = (np.asarray(each, float) for each in (start, low, high))
    goal = _Scaled(lambda x: -sense * function(x), low, high)
    limits = [("eq", equality), ("ineq", inequality)]
    held = [(kind, _Scaled(each, low, high)) for kind, each in limits if each is not None]
    constraints = [{"type": kind, "fun": c.value, "jac": c.slope} for kind, c in held]
    exact = {"maxiter": 500, "ftol": 1e-15}
    found = minimize(
        lambda u: float(goal.value(u)),
        (start - low) / (high - low),
        jac=goal.slope,
        bounds=[(0.0, 1.0)] * len(start),
        constraints=constraints,
        method="SLSQP" if held else "L-BFGS-B",
        options=exact if held else exact | {"gtol": 1e-10, "maxcor": 30, "maxfun": 5000},
    )
    u = np.clip(found.x, 0.0, 1.0)
    value = -sense * float(goal.value(u))
    residual = first_order(u, goal, held) / max(1.0, abs(value))
    slope = -sense * goal.slope(u) / (high - low)
    x = low + (high - low) * u
    return Recipe(x, value, slope, residual, int(found.nit), residual <= TOLERANCE)


def first_order(u: np.ndarray, goal: _Scaled, held) -> float:
    """The residual of the Karush-Kuhn-Tucker conditions at u, the largest of: what no
    multipliers of the right sign explain of the gradient, and violations of constraints.

    Minimising f: grad f = sum of multipliers times gradients of what is active. Bounds and
    inequalities count as active within 1e-7.
    """
    active, lower, violation = [], [], 0.0
    for i, each in enumerate(u):
        row = np.zeros(len(u))
        if each <= 1e-7:
            row[i] = 1.0
        elif each >= 1 - 1e-7:
            row[i] = -1.0
        if row.any():
            active.append(row)
            lower.append(0.0)
    for kind, constraint in held:
        values = np.atleast_1d(constraint.value(u))
        slopes = np.reshape(constraint.slope(u), (len(values), len(u)))
        for value, row in zip(values, slopes):
            violation = max(violation, abs(value) if kind == "eq" else -value)
            if kind == "eq" or value <= 1e-7:
                active.append(row)
                lower.append(-np.inf if kind == "eq" else 0.0)
    slope = goal.slope(u)
    if not active:
        return float(np.max(np.abs(slope)))
    fit = lsq_linear(np.array(active).T, slope, (lower, np.inf), method="bvls")
    return float(max(np.max(np.abs(fit.fun)), violation))


def within_limits(process: Process, values: Array, width: float) -> Array:
    """The smooth indicator that all limits hold: a product of logistic curves, each `width`
    times the attribute's margin wide."""
    held = jnp.ones(())
    for q, each in enumerate(process.case.attributes):
        if each.low is not None:
            held = held * jax.nn.sigmoid((values[q] - each.low) / (width * each.margin))
        if each.high is not None:
            held = held * jax.nn.sigmoid((each.high - values[q]) / (width * each.margin))
    return held


def best_recipe(
    process: Process, entries: Sequence[Entry], low, high, draws, widths=(1.0, 0.3, 0.1)
) -> Recipe:
    """The entries' values, within [low, high], with the largest chance to keep all limits.

    `draws`: [N, U] of the case's uncertain numbers; the value is of these, smooth, at the last
    of `widths` (of the logistic curves, in margins), each solution being the next one's start.
    """
    entries, nominal = tuple(entries), process.given()
    uncertain = process.case.uncertainty
    drawn = tuple(zip(uncertain.inputs, uncertain.entries))
    rows = np.asarray(draws, float)
    low, high = np.asarray(low, float), np.asarray(high, float)
    x, total, recipe = np.clip(process.at(entries), low, high), 0, None
    for width in widths:

        def chance(x, width=width):
            def one(row):
                moved = process.shifted(row, drawn, process.shifted(x, entries, nominal))
                return within_limits(process, process.attributes(moved), width)

            return jnp.mean(jax.vmap(one)(rows))

        recipe = best(chance, x, low, high)
        x, total = recipe.x, total + recipe.iterations
    assert recipe is not None
    return recipe._replace(iterations=total)
