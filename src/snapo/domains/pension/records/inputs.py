"""Every number of a pension case that has a gradient, as `Input`s under the case's names."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from snapo.case.given import CaseInput
from snapo.problem.inputs import Input

from .case import PensionCase


def pension_inputs(case: PensionCase) -> dict[str, Input]:
    """{name: Input} of markets, people and plan, without those that the case holds fixed."""
    inputs: dict[str, Input] = {}
    for values in every_given(case):
        if values.name in inputs:
            raise ValueError(f"{values.name}: two inputs of a case share this name.")
        if values.name not in case.held:
            inputs[values.name] = values.input()
    return inputs


def every_given(record: Any) -> Iterator[CaseInput]:
    """All numbers given in a record and the records within it; empty ones are left out."""
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, CaseInput):
            if value.values.size:
                yield value
        elif is_dataclass(value):
            yield from every_given(value)


def use(inputs: dict[str, Any], values: CaseInput) -> Array:
    """The numbers where they are used: input or number held fixed, at `given.index`."""
    if not values.values.size:
        return jnp.zeros(values.index.shape)
    return jnp.asarray(inputs.get(values.name, values.values))[values.index]
