"""A run without a policy, calculated at other inputs."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from snapo.solver import statistics
from snapo.study.study import Recalculated, Study

from .case.places import InputPositions
from .moves import NONE, InputValues, Rebuild, SelectedChoices, WhatIf
from .terms import handles

EXACT = {"low": None, "high": None}  # a derivative without noise has no interval


class Recalculation(WhatIf):
    """A run that trains nothing: its figures at other inputs, as its domain calculates them."""

    def __init__(
        self, study: Study, values: Recalculated, positions: InputPositions, rebuilt: Rebuild
    ):
        super().__init__(study, values.inputs_by_name, positions, rebuilt)
        self.values, self.paths = values, 0
        self._variants: dict[str, Recalculated] = {}
        self._base: np.ndarray | None = None

    def counted(self) -> dict[str, int]:
        return {"value": self.paths}

    def settings(self) -> dict[str, Any]:
        return {}

    def stages(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> Iterator[tuple[str, Any]]:
        """Those of the domain, the value with its change against the run."""
        if self._base is None and (values or selected):
            next(self.stages({}))
        changed, case = self.changed(values), self.case_at(values, selected).case
        for name, table in self._of(case, selected).stages(case):
            if name == "value":
                yield name, self._value(table, bool(changed or selected))
            elif name == "deltas":
                yield name, [self._by_handle(row) for row in table]
            else:
                yield name, table

    def _of(self, case: Any, selected: SelectedChoices) -> Recalculated:
        """What calculates at these choices: made once for each."""
        if not selected:
            return self.values
        key = repr(sorted(selected.items()))
        if key not in self._variants:
            made = self.rebuild(case).recalculated
            assert made is not None
            self._variants[key] = made()
        return self._variants[key]

    def _value(self, table: dict[str, Any], changed: bool) -> dict[str, Any]:
        """The value, and how it differs from the run's on the same paths."""
        selected = np.asarray(table.pop("kept"))
        self._base = selected if self._base is None else self._base
        self.paths = table["paths"]
        change = statistics.mean(selected - self._base)
        return table | {
            "change": change.value if changed else 0.0,
            "change_error": change.standard_error if changed else 0.0,
        }

    def _by_handle(self, row: dict[str, Any]) -> dict[str, Any]:
        """Derivatives by what is moved together."""
        numbers = [item["value"] for item in row["rows"]]
        rows = [
            {"label": label, "value": sum(numbers[i] for i in at), **EXACT}
            for label, at in handles(self.inputs_by_name[row["input"]])
        ]
        return row | {"rows": rows}
