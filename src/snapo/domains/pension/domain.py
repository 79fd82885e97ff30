"""The domain of pension funds: from a case's tables to its study and its report."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    from snapo.study.domain import Options, Report
    from snapo.study.study import Study, Tell

    from .records.case import PensionCase

SIZES = ("small", "medium", "large", "wtp")


@dataclass(frozen=True)
class PensionFund:
    """Cases of kind "pension"; see `snapo.study.domain.Domain`."""

    kind: str = "pension"
    words: str = "a pension fund that rebalances against its liabilities"

    @property
    def templates(self) -> "Mapping[str, Traversable]":
        home = files(__package__ or "") / "templates"
        return {size: home / size for size in SIZES}

    def read(self, file: Path, data: Mapping[str, Any]) -> "PensionCase":
        from .read.case import resolve

        return resolve(file, dict(data))

    def check(self, case: "PensionCase") -> list[str]:
        from .results.figures.lines import lines

        return lines(case)

    def study(self, case: "PensionCase", options: "Options") -> "Study":
        """The classical policies are always tuned: `reference` asks for nothing more."""
        from .results.study import pension_study

        return pension_study(case, options)

    def report(self) -> "Report":
        from .sections.page import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        what = "the times of pension funds are those of `python -m benchmarks.pension`"
        raise CaseError("KIND", "", self.kind, what)
