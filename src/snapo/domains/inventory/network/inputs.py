"""The numbers of a network that have a sensitivity, and the demand of its places made of them."""

from typing import Any

from snapo.problem.inputs import Input

from ..demand.base import Demand, as_input
from .records import NetworkCase, Site


def network_inputs(case: NetworkCase) -> dict[str, Input]:
    """Every number of the case that has a sensitivity; those of a place's demand as "NAME.key"."""
    costs = [case.holding, case.shortage, case.ordering, case.transshipment]
    mades = {cost.name: cost.input() for cost in costs if cost is not None}
    for site in case.sites:
        for x in site.inputs():
            mades[f"{site.name}.{x.name}"] = as_input(x)
    return mades


def selling(case: NetworkCase) -> list[tuple[Site, Demand]]:
    """The places with customers, in the order of `case.sellers`, and their demand."""
    positions = [case.sites[i] for i in case.sellers]
    return [(position, position.demand) for position in positions if position.demand is not None]


def demands(case: NetworkCase, inputs: Any) -> list[tuple[Demand, dict[str, Any]]]:
    """(demand, its parameters, and the season where there is one) of every place that sells."""
    return [(demand, _own(inputs, position.name)) for position, demand in selling(case)]


def _own(inputs: Any, name: str) -> dict[str, Any]:
    """The inputs of one place."""
    start = f"{name}."
    return {key[len(start) :]: inputs[key] for key in inputs if key.startswith(start)}
