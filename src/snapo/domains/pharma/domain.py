"""The domain of pharmaceutical processes: from a case file to a study and its report.

Nothing heavy is imported until it is asked for: `snapo new` and `snapo --help` answer at once.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from snapo.study.domain import Options, Report
    from snapo.study.study import Study, Tell

    from .flowsheet.case import PharmaCase


@dataclass(frozen=True)
class Pharma:
    """Flowsheets of unit operations, from what enters to the quality of the product."""

    kind: str = "pharma"
    words: str = "a pharmaceutical process: sensitivities, design space, best recipe, closed loop"

    @property
    def templates(self):
        return {"standard": files("snapo.domains.pharma") / "template"}

    def read(self, file: Path, data: Mapping[str, Any]) -> "PharmaCase":
        from .read.case import resolve

        return resolve(file, dict(data))

    def check(self, case: "PharmaCase") -> list[str]:
        from .results.lines import lines

        return lines(case)

    def study(self, case: "PharmaCase", options: "Options") -> "Study":
        from .study import study

        return study(case, options)

    def report(self) -> "Report":
        from .report import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        from .bench import bench

        return bench(engine, tell)


DOMAIN = Pharma()
