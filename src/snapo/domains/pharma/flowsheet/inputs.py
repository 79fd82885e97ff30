"""Every number of a pharma case that has a gradient, as `Input`s named "unit.field"."""

from snapo.case.quantity import numbers_in
from snapo.problem.inputs import Input

from .case import PharmaCase


def pharma_inputs(case: PharmaCase) -> dict[str, Input]:
    """{name: Input} of kinetics, feeds and units, without those that the case holds fixed."""
    found: dict[str, Input] = {}
    for given in numbers_in((case.network, case.feeds, case.units)):
        if given.name in found:
            raise ValueError(f"{given.name}: two inputs of a case share this name.")
        if given.name not in case.held:
            found[given.name] = given.input()
    return found
