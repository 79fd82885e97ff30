"""Every number of a storage case that has a gradient, as `Input`s under the case's own names."""

from collections.abc import Iterator

from snapo.case.given import CaseInput
from snapo.case.quantity import numbers_in
from snapo.problem.inputs import Input

from .records import StorageCase


def storage_inputs(case: StorageCase) -> dict[str, Input]:
    """{name: Input} of contract, market and prices: forward prices, rates, ratchets, costs …"""
    numbers: dict[str, CaseInput] = {}
    for entry in numbers_of(case):
        if numbers.setdefault(entry.name, entry) is not entry:
            raise ValueError(f"{entry.name}: two inputs of a case share this name.")
    return {name: entry.input() for name, entry in numbers.items()}


def numbers_of(case: StorageCase) -> Iterator[CaseInput]:
    """Every number of contract, market and prices."""
    return numbers_in((case.contract, case.market, case.model))
