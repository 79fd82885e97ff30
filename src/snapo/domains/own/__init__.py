"""The domain of a simulator of the user's own: the same commands, resume and report as any other.

The simulator is Python beside the case. Only the command line names code to run; a case is data.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError

if TYPE_CHECKING:
    from snapo.study.domain import Options, Report
    from snapo.study.study import Study, Tell

    from .records import OwnCase

KIND = "own"
OPTION = "--simulator"


@dataclass(frozen=True)
class Own:
    """Cases whose simulator the command line names.

    - `place`: module and class, as in `--simulator simulator:Reservoir`.
    """

    place: tuple[str, str] | None = None
    kind: str = KIND
    words: str = "a simulator of your own, in Python beside the case"
    example: str = "simulator:Reservoir"

    @property
    def templates(self):
        return {"reservoir": files(__name__) / "template"}

    def with_simulator(self, module: str, name: str) -> "Own":
        return replace(self, place=(module, name))

    def decides(self, case: "OwnCase") -> Mapping[str, Any]:
        return {"simulator": ":".join(case.place), "simulator file": case.code_hash}

    def read(self, file: Path, data: Mapping[str, Any]) -> "OwnCase":
        if self.place is None:
            what = (
                f'a case of kind "{KIND}" does not name code to run; name its simulator as '
                f"MODULE:CLASS, such as {OPTION} {self.example}"
            )
            raise CaseError(OPTION, "", None, what)
        from .read import read_case

        return read_case(file, data, self.place)

    def check(self, case: "OwnCase") -> list[str]:
        from .study import checked, lines

        return [str(checked(case)), *lines(case)]

    def study(self, case: "OwnCase", options: "Options") -> "Study":
        from .study import study

        return study(case, options)

    def report(self) -> "Report":
        from .report import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        what = "this kind brings no simulator to time; `snapo solve` reports the times of yours"
        raise CaseError("KIND", "", KIND, what)


DOMAIN = Own()
