"""The value as its domain shows it: for a fund, for example, the certainty equivalent instead of
the utility."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from snapo.study.study import DisplayedValue

from .moves import WhatIf

INTERVAL = ("value", "low", "high")


class HeadlineTables:
    """The tables of a page with the value, its changes and its derivatives in the headline's unit.
    If the domain or the value has no headline, the tables are unchanged.
    """

    def __init__(self, valuation: WhatIf):
        self.valuation = valuation
        self.base: tuple[float, DisplayedValue] | None = None  # the run's value, and its headline
        self.slope = 1.0  # d headline / d value at the value that was shown last

    def table(self, stage: str, table: Any) -> Any:
        """The table of a stage, as the page shows it."""
        convert: Callable[[Any], Any] | None = {
            "value": self._value, "deltas": self._deltas, "explained": self._explained,
            "trained": self._trained, "bounded": self._bounded,
        }.get(stage)  # fmt: skip
        return table if convert is None else convert(table)

    def inputs(self, inputs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """The inputs, with the derivative of the headline at the run's value."""
        if self.base is None:
            return list(inputs)
        slope = self.base[1].slope
        slopes = [None if x["slope"] is None else slope * x["slope"] for x in inputs]
        return [entry | {"slope": new} for entry, new in zip(inputs, slopes)]

    def units(self) -> dict[str, Any]:
        """The units; the value has the unit and the name of the headline."""
        units = self.valuation.units()
        if self.base is None:
            return units
        return units | {"unit": self.base[1].unit, "meaning": self.base[1].name}

    def _at(self, value: float) -> DisplayedValue | None:
        return self.valuation.headline(value)

    def _value(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        now = self._at(table["value"])
        if now is None:
            return table
        if self.base is None:
            self.base = table["value"], now
        self.slope, base = now.slope, self.base[1]
        return {
            **table,
            "value": now.number,
            "standard_error": now.slope * table["standard_error"],
            "change": now.number - base.number,
            "change_error": now.slope * table["change_error"],
            "predicted": base.slope * table["predicted"],
            "by_input": {name: base.slope * x for name, x in table["by_input"].items()},
        }

    def _deltas(self, rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        def scaled(row: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
            numbers = {key: row[key] for key in keys if row.get(key) is not None}
            return {**row, **{key: self.slope * x for key, x in numbers.items()}}

        keys = ("effect", "low", "high")
        return [
            {**scaled(row, keys), "rows": [scaled(x, INTERVAL) for x in row["rows"]]}
            for row in rows
        ]

    def _explained(self, rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """Steps of the value as steps of the headline, which add up to its change."""
        if self.base is None:
            return list(rows)
        value, before = self.base
        result = []
        for row in rows:
            value += row["change"]
            now = self._at(value)
            if now is None:
                return list(rows)
            errors = {"error": now.slope * row["error"]}
            result.append({**row, "change": now.number - before.number, **errors})
            before = now
        return result

    def _trained(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        after, before = self._at(table["value"]), self._at(table["value"] - table["gain"])
        if after is None or before is None:
            return table
        errors = {key: after.slope * table[key] for key in ("standard_error", "gain_error")}
        return {**table, "value": after.number, "gain": after.number - before.number, **errors}

    def _bounded(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        lower, upper = (self._at(table[name]["value"]) for name in ("lower", "upper"))
        if lower is None or upper is None:
            return table
        gap = {
            "value": upper.number - lower.number,
            "standard_error": upper.slope * table["gap"]["standard_error"],
        }
        error = {"standard_error": upper.slope * table["upper"]["standard_error"]}
        return {**table, "upper": {"value": upper.number, **error}, "gap": gap}
