"""The numbers of a case by their names in the file, such as "reactor.temperature[0]"."""

import math
import re
from typing import Any, NamedTuple

from snapo.case.given import CaseInput

from ..flowsheet.network import FlowNetwork
from ..given import Entry
from .numbers import Location, suggest
from .quantities import prefactor_unit

TINY = 1e-300  # the smallest number above 0
ENTRY = re.compile(r"([^\[\]]+)(?:\[([^\[\]]+)\])?")


class EntryNumbers(NamedTuple):
    """Every number of the case by its name, with the unit of each entry."""

    givens: dict[str, CaseInput]
    network: FlowNetwork

    def unit(self, name: str, entry: int) -> str:
        """The domain's unit of one entry; the entries of powers and rate constants may have
        different units."""
        unit = self.givens[name].unit
        if unit == "(m3/kmol)^(order-1)/s":
            return prefactor_unit(self.network.order[entry].sum())
        if ", " in unit:
            return unit.split(", ")[entry]
        return unit.replace("K^k", f"K^{entry}").replace("m^k/m3", f"m^{entry}/m^3")

    def all(self, section: Location, key: str, text: str) -> list[Entry]:
        """The entries that a text such as "name", "name[1]" or "name[label]" means."""
        result = ENTRY.fullmatch(text)
        name = result[1] if result else text
        if result is None or name not in self.givens:
            hint = suggest(name, self.givens, "number")
            raise section.error(key, text, f"there is no such number; {hint}")
        labels = self.givens[name].labels
        if result[2] is None:
            return [(name, i) for i in range(len(labels))]
        if result[2] in labels:
            return [(name, labels.index(result[2]))]
        if result[2].isdigit() and int(result[2]) < len(labels):
            return [(name, int(result[2]))]
        available = f"0 to {len(labels) - 1}"
        available += f" or {', '.join(labels)}" if any(labels) else ""
        raise section.error(key, text, f"its entries are {available}")

    def one(self, section: Location, key: str, text: str) -> Entry:
        """The one entry that a text means."""
        result = self.all(section, key, text)
        if len(result) > 1:
            message = f"{text} has {len(result)} entries; specify one, such as {text}[0]"
            raise section.error(key, text, message)
        return result[0]

    def check(self, section: Location, key: str, raw: Any, entry: Entry, value: float) -> None:
        """Refuses a `value` that is not allowed for the number."""
        values = self.givens[entry[0]]
        if not values.low <= value <= values.high:
            raise section.error(key, raw, f"{self.name_of(entry)} is {limits(values)}")

    def name_of(self, entry: Entry) -> str:
        """An entry as a case names it."""
        name, position = entry
        label = self.givens[name].labels[position]
        return f"{name}[{label}]" if label else name

    def value(self, entry: Entry) -> float:
        return float(self.givens[entry[0]].values[entry[1]])


def limits(values: CaseInput) -> str:
    """The allowed values of a number, as text: "above 0", "from 100 to 1000 K"."""
    unit = "" if values.unit == "1" or "order" in values.unit else f" {values.unit}"
    if values.high < math.inf:
        return f"from {values.low:.6g} to {values.high:.6g}{unit}"
    return "above 0" if 0 < values.low < TINY else f"at least {values.low:.6g}{unit}"
