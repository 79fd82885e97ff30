"""The domain of inventories: how a case becomes a study, and how its run is told."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError

if TYPE_CHECKING:
    from snapo.study.domain import Options, Report
    from snapo.study.study import Study, Tell

    from .item.records import InventoryCase
    from .network.records import NetworkCase


class Inventory:
    """Orders of an item under random demand; see `snapo.study.domain.Domain`."""

    kind = "inventory"
    words = "an inventory: orders, service and costs under random demand"

    @property
    def templates(self):
        folder = files(__package__ or "")
        return {"spare-part": folder / "template", "line": folder / "template_line",
                "stores": folder / "template_stores"}  # fmt: skip

    def read(self, file: Path, data: Mapping[str, Any]) -> "InventoryCase | NetworkCase":
        if "place" in data:
            from .read.network import read_network

            return read_network(file, data)
        from .read.case import read_case

        return read_case(file, data)

    def check(self, case: "InventoryCase | NetworkCase") -> list[str]:
        return _study_of(case).lines(case)

    def study(self, case: "InventoryCase | NetworkCase", options: "Options") -> "Study":
        return _study_of(case).study(case, options)

    def report(self) -> "Report":
        from .report import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        what = "this kind brings no case to time; `snapo solve` reports the times of yours"
        raise CaseError("KIND", "", self.kind, what)


def _study_of(case: Any) -> Any:
    """The study of one item, or that of places."""
    from .network import study as places
    from .network.records import NetworkCase

    if isinstance(case, NetworkCase):
        return places
    from . import study

    return study
