"""Every number of a storage case that has a gradient, as `Input`s under the case's own names."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from snapo.case.given import Given
from snapo.problem.inputs import Input

from .records import StorageCase


def storage_inputs(case: StorageCase) -> dict[str, Input]:
    """{name: Input} of contract, market and prices: forward prices, rates, ratchets, costs …"""
    found: dict[str, Given] = {}
    for given in _given((case.contract, case.market, case.model)):
        if found.setdefault(given.name, given) is not given:
            raise ValueError(f"{given.name}: two inputs of a case share this name.")
    return {name: given.input() for name, given in found.items()}


def _given(records) -> Iterator[Given]:
    for record in records:
        for field in fields(record):
            value = getattr(record, field.name)
            if isinstance(value, Given):
                if value.values.size:
                    yield value
            elif is_dataclass(value):
                yield from _given((value,))
