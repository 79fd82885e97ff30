"""Numbers of the case by the texts that speak of them: "reactor.temperature[0]"."""

import re
from typing import NamedTuple

from snapo.case.given import Given
from snapo.case.table import Section

from ..flowsheet.network import Network
from ..given import Entry
from .numbers import suggest

ENTRY = re.compile(r"([^\[\]]+)(?:\[([^\[\]]+)\])?")


class Numbers(NamedTuple):
    """Every number of the case by its name, with the unit of each entry."""

    givens: dict[str, Given]
    network: Network

    def unit(self, name: str, entry: int) -> str:
        """The domain's unit of one entry: those of powers and rate constants differ."""
        unit = self.givens[name].unit
        if unit == "(m3/kmol)^(order-1)/s":
            order = self.network.order[entry].sum()
            return f"m^{3 * (order - 1):g}*kmol^{1 - order:g}/s"
        if ", " in unit:
            return unit.split(", ")[entry]
        return unit.replace("K^k", f"K^{entry}").replace("m^k/m3", f"m^{entry}/m^3")

    def all(self, section: Section, key: str, text: str) -> list[Entry]:
        """The entries that "name", "name[1]" or "name[label]" stands for."""
        found = ENTRY.fullmatch(text)
        name = found[1] if found else text
        if found is None or name not in self.givens:
            hint = suggest(name, self.givens, "number")
            raise section.error(key, text, f"there is no such number; {hint}")
        labels = self.givens[name].labels
        if found[2] is None:
            return [(name, i) for i in range(len(labels))]
        if found[2] in labels:
            return [(name, labels.index(found[2]))]
        if found[2].isdigit() and int(found[2]) < len(labels):
            return [(name, int(found[2]))]
        known = f"0 to {len(labels) - 1}"
        known += f" or {', '.join(labels)}" if any(labels) else ""
        raise section.error(key, text, f"its entries are {known}")

    def one(self, section: Section, key: str, text: str) -> Entry:
        """The one entry that a text stands for."""
        found = self.all(section, key, text)
        if len(found) > 1:
            what = f"{text} has {len(found)} entries; say which, such as {text}[0]"
            raise section.error(key, text, what)
        return found[0]

    def value(self, entry: Entry) -> float:
        return float(self.givens[entry[0]].values[entry[1]])
