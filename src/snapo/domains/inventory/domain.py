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


class Inventory:
    """Orders of an item under random demand; see `snapo.study.domain.Domain`."""

    kind = "inventory"
    words = "an inventory: orders, service and costs under random demand"

    @property
    def templates(self):
        return {"spare-part": files(__package__ or "") / "template"}

    def read(self, file: Path, data: Mapping[str, Any]) -> "InventoryCase":
        from .read.case import read_case

        return read_case(file, data)

    def check(self, case: "InventoryCase") -> list[str]:
        from .study import lines

        return lines(case)

    def study(self, case: "InventoryCase", options: "Options") -> "Study":
        from .study import study

        return study(case, options)

    def report(self) -> "Report":
        from .report import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        what = "this kind brings no case to time; `snapo solve` reports the times of yours"
        raise CaseError("KIND", "", self.kind, what)
