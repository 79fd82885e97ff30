"""The best recipe of the nominal model: `[optimise]` of a case, solved with a test of the
optimality conditions."""

import time
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.case.quantity import numbers_in

from ..derivatives.jacobian import choose, matrix
from ..derivatives.sensitivities import spread
from ..flowsheet.case import PharmaCase
from ..flowsheet.process import PharmaProcess
from ..quality import batches
from ..quality.draws import all_entries
from .optimum import Recipe, TracedRecipe, optimum
from .records import Term


class AttributeLimit(NamedTuple):
    """A limit of attribute number `which`: `sign` (value - `limit`) >= `reserve`; divided by `size`
    it is of order one."""

    name: str
    unit: str
    which: int
    sign: int
    limit: float
    reserve: float
    size: float


class Ramp(NamedTuple):
    """A piece between two nodes of a profile: the largest change per second, over a share of the
    duration."""

    name: str
    unit: str
    input: str
    entry: int
    duration: str
    share: float
    steepest: float


class Optimum(NamedTuple):
    """`recipe`: its x are the decisions, and its constraints those of `bounds`, then two for each
    of `ramps`. `before`: the goal at the start; `endpoints`: the goal that the search reached from
    each start. `mode`: how the goal was differentiated; `compiling`, `solving`: seconds.
    """

    recipe: Recipe
    bounds: tuple[AttributeLimit, ...]
    ramps: tuple[Ramp, ...]
    before: float
    mode: str
    compiling: float
    solving: float
    endpoints: tuple[float, ...]


def optimise(process: PharmaProcess, seed: int = 0) -> Optimum:
    """Chooses the decisions of the case's `[optimise]`; all limits are constraints.

    With several starts the result is the best of those that meet the conditions, or the best of all
    if none does.
    """
    case = process.case
    ask = case.optimise
    if ask is None:
        raise ValueError("optimise: the case has no [optimise].")
    limits, steep = bounds(case, varies(process)), ramps(case)
    count = 1 + len(limits) + 2 * len(steep)
    mode, reason = choose(process, count, len(ask.decisions), "auto")
    traced = TracedRecipe(goal_and_room(process, limits, steep), mode)
    low, high, local = (
        np.array([getattr(decision, key) for decision in ask.decisions])
        for key in ("low", "high", "start")
    )
    traced.compile(local)
    started = time.perf_counter()
    before = float(traced(local)[0][0])
    random = np.random.default_rng(seed).uniform(size=(ask.starts - 1, len(local)))
    recipes: list[Recipe] = []
    for start in (local, *(low + (high - low) * random)):
        scale = abs(float(traced(start)[0][0])) or 1.0
        recipes.append(optimum(traced, start, low, high, sense=ask.sense, scale=scale))
    best = max(recipes, key=lambda item: (item.converged, ask.sense * item.value))
    solving = time.perf_counter() - started
    endpoints = tuple(entry.value for entry in recipes)
    recipe = best._replace(evaluations=traced.evaluations)
    return Optimum(recipe, limits, steep, before, reason, traced.compiling, solving, endpoints)


def goal_and_room(
    process: PharmaProcess, limits: tuple[AttributeLimit, ...], steep: tuple[Ramp, ...]
):
    """The function from decisions [n] to the goal, the distance to every limit, and two distances
    for every ramp."""
    case, nominal = process.case, process.nominal_inputs()
    ask = case.optimise
    assert ask is not None
    entries = tuple((decision.input, decision.entry) for decision in ask.decisions)
    held = {
        number.name: number.values for number in numbers_in((case.network, case.feeds, case.units))
    }

    def function(x):
        inputs = process.shifted(x, entries, nominal)
        measures = process.flow(inputs, along=True, nominal_steps=False).measures
        inputs = held | inputs
        attributes = process.of_measures(measures)
        goal = _sum(ask.terms, measures, inputs)
        if ask.per:
            goal = goal / _sum(ask.per, measures, inputs)
        room = [
            (limit.sign * (attributes[limit.which] - limit.limit) - limit.reserve) / limit.size
            for limit in limits
        ]
        for item in steep:
            allowed = item.steepest * item.share * inputs[item.duration][0]
            change = inputs[item.input][item.entry + 1] - inputs[item.input][item.entry]
            room += [1 - change / allowed, 1 + change / allowed]
        return jnp.stack([goal, *room])

    return function


def _sum(terms: tuple[Term, ...], measures, inputs) -> Array:
    """The sum of terms; `inputs` has every number of the case, including held ones."""
    total = jnp.zeros(())
    for term in terms:
        value = measures[term.of] if term.entry is None else inputs[term.of][term.entry]
        total = total + term.weight * term.scale * value
    return total


def varies(process: PharmaProcess) -> np.ndarray:
    """[Q] standard deviation of the batches about the case's recipe, to first order, in the
    attributes' units; zeros if the case does not need it."""
    case = process.case
    assert case.optimise is not None
    available = len(all_entries(case))
    if not (case.optimise.deviations and available):
        return np.zeros(len(case.attributes))
    # The run's matrix is of the same function, so that nothing compiles again.
    jacobian = matrix(process, entries=batches.varied(case)).jacobian[:, :available]
    return spread(case, jacobian).total


def bounds(case: PharmaCase, deviation: np.ndarray) -> tuple[AttributeLimit, ...]:
    """The limits of all attributes as inequalities, with the reserve; `deviation` [Q]."""
    ask = case.optimise
    assert ask is not None
    results = []
    for q, attribute in enumerate(case.attributes):
        reserve = ask.reserve * attribute.margin + ask.deviations * float(deviation[q])
        for sign, limit in ((1, attribute.low), (-1, attribute.high)):
            if limit is not None:
                size = abs(limit) or attribute.margin
                results.append(
                    AttributeLimit(attribute.name, attribute.unit, q, sign, limit, reserve, size)
                )
    return tuple(results)


def ramps(case: PharmaCase) -> tuple[Ramp, ...]:
    """Ramps of the profiles whose nodes or duration are decided."""
    ask = case.optimise
    assert ask is not None
    decided = {decision.input for decision in ask.decisions}
    results = []
    for unit in case.units:
        for profile in unit.profiles:
            name, duration = profile.value.name, f"{unit.name}.duration"
            maximum = profile.ramp
            if maximum is None or profile.kind != "linear" or not decided & {name, duration}:
                continue
            for i, share in enumerate(np.diff(profile.share).tolist()):
                metadata = f"{name}[{i}] to [{i + 1}]"
                results.append(
                    Ramp(metadata, profile.value.unit, name, i, duration, share, maximum)
                )
    return tuple(results)
