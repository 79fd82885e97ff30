"""The domain of user-defined simulators, with the same commands and reports as other domains.

The simulator is Python code next to the case. Only the command line names code to run; a case is
data.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snapo.case.error import CaseError
from snapo.study.kind import Kind

if TYPE_CHECKING:
    from .records import OwnCase

KIND = "own"
OPTION = "--simulator"


@dataclass(frozen=True, eq=False)
class OwnDomain(Kind):
    """Cases whose simulator the command line names.

    - `location`: module and class, as in `--simulator simulator:Reservoir`.
    """

    location: tuple[str, str] | None = None
    example: str = "simulator:Reservoir"

    def with_simulator(self, module: str, name: str) -> "OwnDomain":
        return replace(self, location=(module, name))

    def decides(self, case: "OwnCase") -> Mapping[str, Any]:
        return {"simulator": ":".join(case.location), "simulator file": case.code_hash}

    def read(self, file: Path, data: Mapping[str, Any]) -> "OwnCase":
        if self.location is None:
            message = (
                f'a case of kind "{KIND}" cannot name code; name its simulator with the option '
                f"{OPTION} MODULE:CLASS, such as {OPTION} {self.example}"
            )
            raise CaseError(OPTION, "", None, message)
        return self.loaded(self.reader)(file, data, self.location)


DOMAIN = OwnDomain(
    KIND,
    "your own simulator, in Python next to the case",
    __name__,
    {"reservoir": "template"},
    reader="read:read_case",
    summary="study:summary",
    tables="read:FORMATS",
)
