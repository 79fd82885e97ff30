"""The classical rules of a network, with their best numbers: echelon base stock and (s, S)."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.study.study import Setup

from ..policy.search import cost_on_other_paths, search
from ..setup import network_of
from .estimates import first_batches
from .policy import EchelonRule

FINEST = 1 / 16  # of a level, in deviations of demand
ENDLESS = 1e6  # deviations: nothing is sent, or an order waits for nothing
BAND = 0.5  # deviations: where the search for one begins


class RuleNumbers(NamedTuple):
    """The numbers of a classical rule, in standard deviations of the demand that a place serves.

    - `above` [n]: the levels of the rule minus those of the simulator.
    - `reserve`: the band of all stores before demand. Stores hold nothing back after demand, unless
      `reserve` is `ENDLESS`.
    - `wait` [m]: the levels of the simulator minus the reorder points, for each place with a fixed
      cost; None if a place orders whenever it is below its level.
    """

    above: tuple[float, ...]
    reserve: float = 0.0
    wait: tuple[float, ...] | None = None


def network_rules(setup: Setup) -> Iterator[tuple[str, EchelonRule, dict[str, float]]]:
    """Triples (name, rule, its numbers as a planner writes them). The rules are echelon base stock
    at its first levels, and echelon base stock at the best levels of a search on other paths. If
    orders have a cost, there is also an echelon (s, S) rule. If stores may exchange goods, there is
    also the best rule without exchange."""
    for name, numbers in classical(setup).items():
        yield name, echelon_rule(setup, *numbers), _for_planner(setup, numbers)


def classical(setup: Setup) -> dict[str, RuleNumbers]:
    """{name: numbers of the rule}. After demand, stores hold nothing back; before demand, the band
    is one more number of the search."""
    case = network_of(setup)
    first = RuleNumbers(
        (0.0,) * len(case.network.sites), BAND if case.network.moving(True) else 0.0
    )
    rules = {"newsvendor levels": first._replace(reserve=0.0), "best levels": best(setup, first)}
    name = "best levels"
    if case.network.fixed:
        batch, wait = first_batches(case)
        first = first._replace(above=tuple(batch.tolist()), wait=tuple(wait.tolist()))
        name = "(s, S) of echelons"
        rules[name] = best(setup, first)
    if case.network.pools:
        rules[f"{name}, nothing sent"] = best(setup, first._replace(reserve=ENDLESS))
    return rules


def echelon_rule(
    setup: Setup,
    above: Sequence[float],
    selected: float = 0.0,
    wait: Sequence[float] | None = None,
) -> EchelonRule:
    """The rule with these `RuleNumbers`."""
    problem, case = setup.problem, network_of(setup)
    rule = EchelonRule(
        case.network, problem.action, problem.features, key=jax.random.key(0), plain=True
    )
    after = len(case.network.moving(False))
    keeps = [selected if selected == ENDLESS else 0.0] * after + [selected] * len(
        case.network.moving(True)
    )
    waits = [-ENDLESS] * len(case.network.fixed) if wait is None else wait
    values = tuple(jnp.asarray(x, jnp.float32) for x in (above, keeps, waits))
    return eqx.tree_at(lambda x: (x.first, x.reserve, x.wait), rule, values)


def best(setup: Setup, start: RuleNumbers) -> RuleNumbers:
    """The best numbers in a search that starts from `first`: levels and, if the rule has them,
    reorder points and the band."""
    case, cost_of = network_of(setup), cost_on_other_paths(setup)
    waits, banded = start.wait or (), bool(case.network.moving(True)) and start.reserve != ENDLESS
    n = len(start.above)

    def numbers(point: tuple[float, ...]) -> RuleNumbers:
        selected = point[-1] if banded else start.reserve
        wait = point[n : n + len(waits)] if start.wait is not None else None
        return RuleNumbers(point[:n], selected, wait)

    def cost(point: tuple[float, ...]) -> float:
        if banded and point[-1] < 0:
            return np.inf
        return cost_of(echelon_rule(setup, *numbers(point)))

    # A level and its reorder point: the lot, and both together.
    pairs = [(i, n + k) for k, i in enumerate(case.network.fixed)] if waits else []
    first = (*start.above, *waits, *([start.reserve] if banded else []))
    return numbers(search(cost, first, 0.5, FINEST, together=pairs))


def first_levels(setup: Setup) -> np.ndarray:
    """[n] the simulator's levels in the first period that counts."""
    schedule = setup.problem.schedule
    if "level" in schedule.constants:
        return np.asarray(schedule.constants["level"], np.float64)
    return np.asarray(schedule.steps["level"][network_of(setup).warm_up], np.float64)


def _for_planner(setup: Setup, numbers: RuleNumbers) -> dict[str, float]:
    """Levels and reorder points in units, and the band in standard deviations."""
    case, level = network_of(setup), first_levels(setup)
    unit = np.asarray(setup.problem.schedule.constants["unit"])
    levels = level + np.array(numbers.above) * unit
    entries = {site.name: float(x) for site, x in zip(case.network.sites, levels)}
    for i, wait in zip(case.network.fixed, numbers.wait or ()):
        entries[f"{case.network.sites[i].name} from"] = float(level[i] - wait * unit[i])
    banded = case.network.moving(True) and numbers.reserve != ENDLESS
    return entries | ({"band": numbers.reserve} if banded else {})
