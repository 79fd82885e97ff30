"""Every number of a pharma case that has a gradient, as `Input`s named "unit.field"."""

from snapo.case.quantity import numbers_in
from snapo.problem.record import Input

from .case import PharmaCase


def pharma_inputs(case: PharmaCase) -> dict[str, Input]:
    """{name: Input} of kinetics, feeds and units, without those that the case holds fixed."""
    inputs: dict[str, Input] = {}
    for values in numbers_in((case.network, case.feeds, case.units)):
        if values.name in inputs:
            raise ValueError(f"{values.name}: two inputs of a case share this name.")
        if values.name not in case.held:
            inputs[values.name] = values.input()
    return inputs
