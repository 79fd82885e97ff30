"""Inventories: orders under random demand, for one item or for a network of places."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.study.kind import Kind

if TYPE_CHECKING:
    from snapo.study.domain import Case


@dataclass(frozen=True, eq=False)
class Inventory(Kind):
    """Cases of one item, and cases of a network, which have tables `[[place]]`."""

    def read(self, file: Path, data: Mapping[str, Any]) -> "Case":
        network = "place" in data
        return self.loaded("read.network:read_network" if network else self.reader)(file, data)


DOMAIN = Inventory(
    "inventory",
    "an inventory: orders, service and costs under random demand",
    __name__,
    {"spare-part": "template", "line": "template_line", "stores": "template_stores"},
    summary="summary:lines",
    tables="read.network:FORMATS",
)
