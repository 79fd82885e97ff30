"""Every number of a pension case that has a gradient, as `Input`s under the case's names."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.form import Use, formed
from snapo.problem.record import Input, TreeRecord
from snapo.problem.record.arrays import Array, jax
from snapo.problem.record.either import xp

from .case import DerivedNumbers, PensionCase, PensionModel


def pension_inputs(case: PensionCase) -> dict[str, Input]:
    """{name: Input} of markets, people and plan, without those that the case holds fixed."""
    inputs: dict[str, Input] = {}
    for values in every_given(case):
        if values.name in inputs:
            raise ValueError(f"{values.name}: two inputs of a case share this name.")
        if values.name not in case.held:
            inputs[values.name] = values.input()
    return inputs


def input_values(case: PensionCase) -> dict[str, np.ndarray]:
    """{name: values} of the inputs of a case."""
    return {name: entry.value for name, entry in pension_inputs(case).items()}


def every_given(record: Any) -> Iterator[CaseInput]:
    """All numbers of a case in a record and in the records within it; empty ones are left out."""
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, CaseInput):
            if value.values.size:
                yield value
        elif is_dataclass(value):
            yield from every_given(value)


def model_of(case: PensionCase, derived: DerivedNumbers) -> PensionModel:
    """The model that a simulator contains. For cases of the same form, only its arrays differ."""
    parts: dict[str, Any] = {x.name: getattr(case, x.name) for x in fields(PensionModel)}
    parts["derived"] = derived
    # What no path depends on.
    bare = [replace(item, eligible=0.0) for item in case.assets.classes]
    parts["assets"] = replace(case.assets, classes=tuple(bare), risk=())
    parts["currencies"] = replace(case.currencies, emerging=())
    if case.scenarios is not None:
        parts["scenarios"] = replace(case.scenarios, training=None, evaluation=None)
    if case.pots is not None:
        parts["pots"] = replace(case.pots, rules=None)
    elif case.members is not None:
        parts["members"] = replace(case.members, names=())

    def settled(leaf: Any) -> Any:
        if isinstance(leaf, CaseInput):
            held = leaf.name in case.held and leaf.values.size
            return Held(leaf.use(), leaf.values) if held else leaf
        return np.asarray(leaf)

    return formed(jax.tree.map(settled, PensionModel(**parts)))


class Held(TreeRecord):
    """Numbers of a case in a simulator that are not inputs."""

    position: Use
    values: np.ndarray

    def __call__(self, inputs: dict[str, Any]) -> Array:
        """The numbers at the positions where they are used; an input of this name takes their
        place."""
        return self.position({self.position.name: self.values} | inputs)


def use(inputs: dict[str, Any], values: CaseInput | Use | Held) -> Array:
    """The numbers at the positions where they are used: those of the input, or those held fixed."""
    if isinstance(values, Use | Held):
        return values(inputs)
    if not values.values.size:
        return xp.zeros(values.index.shape)
    return xp.asarray(inputs.get(values.name, values.values))[values.index]


def is_empty(values: CaseInput | Use | Held) -> bool:
    """Whether a case has no such numbers."""
    if isinstance(values, Held):
        return False
    return not (values.size if isinstance(values, Use) else values.values.size)
