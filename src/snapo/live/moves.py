"""What every run on the page has, with a policy or without: inputs that move, and their files."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.inputs import Input
from snapo.study.study import Study

from .case.choices import MenuChoice, choices
from .case.choices import case_with as put
from .case.files import Files
from .case.places import ChangedCase, InputPositions
from .terms import described

InputValues = Mapping[str, np.ndarray]
SelectedChoices = Mapping[str, str | bool]  # {key: another value}
Rebuild = Callable[[Any], Study]
NONE: SelectedChoices = {}


class WhatIf:
    """A run whose inputs can be moved.

    - `study`: of the run; `anew`: makes that of another case.
    - `slopes`: {input: d value / d number, flat}; empty where none are known.
    """

    def __init__(
        self, study: Study, inputs: Mapping[str, Input], positions: InputPositions, rebuilt: Rebuild
    ):
        self.study, self.inputs_by_name, self.positions, self.rebuild = (
            study,
            inputs,
            positions,
            rebuilt,
        )
        self.slopes: dict[str, np.ndarray] = {}

    @abstractmethod
    def stages(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> Iterator[tuple[str, Any]]:
        """(name, table) one after another, of what is shown at these numbers and choices.

        **Raises:** `CaseError` where the case's own reader refuses them.
        """

    def afterwards(self) -> Iterator[tuple[str, Any]]:
        """(name, table) of what can wait until the hand rests, after all of `stages`."""
        yield from ()

    @cached_property
    def choices(self) -> list[MenuChoice]:
        """The keys of the case with a list of allowed values."""
        return choices(self.positions.files, self.positions.reread)

    def case_at(self, values: InputValues, selected: SelectedChoices = NONE) -> ChangedCase:
        """The case with these numbers and choices."""
        files = put(self.positions.files, self.choices, selected) if selected else None
        return self.positions.case_at(self.changed(values), files)

    @abstractmethod
    def counted(self) -> dict[str, int]:
        """Numbers of paths: of the "value", and what else there is."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Keys of `[evaluation]` with which `snapo solve` finds what is shown."""

    def source(self, name: str) -> str:
        """Where the run's reported derivative comes from; "" where it does not say."""
        return ""

    def inputs(self) -> list[dict[str, Any]]:
        """All inputs of the case, as the page shows them."""
        return [
            described(name, values, self.slopes.get(name), self.source(name))
            for name, values in self.inputs_by_name.items()
        ]

    def units(self) -> dict[str, Any]:
        """`unit` of the value, and `units` of states and outputs by name, where they are known."""
        about, units = self.study.about, self.study.about.get("units")
        available = dict(units) if isinstance(units, Mapping) else {}
        return {"unit": about.get("value_unit", ""), "units": available}

    def changed(self, values: InputValues) -> dict[str, np.ndarray]:
        """The inputs that differ from the run's, shaped like them.

        **Raises:** `CaseError` for a name that is no input's, or numbers that do not fit.
        """
        news = {}
        for name, value in values.items():
            inputs = self.inputs_by_name.get(name)
            if inputs is None:
                raise CaseError(name, "", None, "there is no such input")
            new = np.asarray(value, np.float64)
            if new.size != inputs.value.size or not np.isfinite(new).all():
                message = f"this input has {inputs.value.size} finite numbers"
                raise CaseError(name, "", None, message)
            new = new.reshape(inputs.value.shape)
            if not np.array_equal(new, inputs.value):
                news[name] = new
        return news

    def files(self, values: InputValues, selected: SelectedChoices = NONE) -> Files:
        """The files of the case with these numbers, so that `snapo solve` finds what is shown."""
        files = self.case_at(values, selected).files.without(self.study.checks)
        table = dict(files.tables.get("evaluation", {})) | self.settings()
        return files.with_value(("evaluation",), table)
