"""The numbers of a network that have a sensitivity, and the demand of its places made of them."""

from typing import Any

import equinox as eqx

from snapo.problem.inputs import Input

from ..demand.base import Demand
from .records import NetworkCase, Place


def network_inputs(case: NetworkCase) -> dict[str, Input]:
    """Every number of the case that has a sensitivity; those of a place's demand as "NAME.key"."""
    costs = [case.holding, case.shortage, case.ordering, case.transshipment]
    found = {each.name: each.input() for each in costs if each is not None}
    for place, demand in selling(case):
        for each in demand.given():
            made = each.input()
            made = eqx.tree_at(lambda x: x.value, made, made.value.reshape(()))
            found[f"{place.name}.{each.name}"] = made
        if place.season is not None:
            found[f"{place.name}.{place.season.name}"] = place.season.input()
    return found


def selling(case: NetworkCase) -> list[tuple[Place, Demand]]:
    """The places with customers, in the order of `case.sellers`, and their demand."""
    places = [case.places[i] for i in case.sellers]
    return [(place, place.demand) for place in places if place.demand is not None]


def demands(case: NetworkCase, inputs: Any) -> list[tuple[Demand, dict[str, Any]]]:
    """(demand, its parameters, and the season where there is one) of every place that sells."""
    return [(demand, _own(inputs, place.name)) for place, demand in selling(case)]


def _own(inputs: Any, name: str) -> dict[str, Any]:
    """The inputs of one place."""
    start = f"{name}."
    return {key[len(start) :]: inputs[key] for key in inputs if key.startswith(start)}
