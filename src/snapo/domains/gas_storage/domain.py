"""The domain of gas storage: how a case becomes a study, and how its run is told."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from snapo.study.domain import Options, Report
    from snapo.study.study import Study, Tell

    from .contract.records import StorageCase


class GasStorage:
    """Storage contracts on natural gas; see `snapo.study.domain.Domain`."""

    kind = "gas-storage"
    words = "a gas storage contract: value, deltas, trigger prices"

    @property
    def templates(self):
        return {"flagship": files(__package__ or "") / "template"}

    def read(self, file: Path, data: Mapping[str, Any]) -> "StorageCase":
        from .read.case import read_case

        return read_case(file, data)

    def check(self, case: "StorageCase") -> list[str]:
        from .study import lines

        return lines(case)

    def study(self, case: "StorageCase", options: "Options") -> "Study":
        from .study import study

        return study(case, options)

    def report(self) -> "Report":
        from .report import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        from .bench import bench

        return bench(engine, tell)
