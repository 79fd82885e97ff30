"""The domain of control: a plant moved step by step towards a target, at the least cost."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from snapo.study.domain import Options, Report
    from snapo.study.study import Study, Tell

    from .records import ControlCase

KIND = "control"
SIZES = (
    "pendulum", "mountain-car", "cart-pole", "double-integrator", "linear-quadratic", "measured",
    "two-tanks", "quadrotor",
)  # fmt: skip


class Control:
    """Cases of `kind = "control"`: one of the plants in `plants/`."""

    kind: str = KIND
    words: str = "a plant to be controlled: pendulum, cart and pole, tanks, a linear one …"

    @property
    def templates(self):
        return {size: files(__name__) / "template" / size for size in SIZES}

    def read(self, file: Path, data: Mapping[str, Any]) -> "ControlCase":
        from .read import read_case

        return read_case(file, data)

    def check(self, case: "ControlCase") -> list[str]:
        from .study import lines

        return lines(case)

    def study(self, case: "ControlCase", options: "Options") -> "Study":
        from .study import study

        return study(case, options)

    def report(self) -> "Report":
        from .report import REPORT

        return REPORT

    def bench(self, engine: str, tell: "Tell") -> str:
        from snapo.case.error import CaseError

        what = "this kind has nothing to time by itself; `snapo solve` reports the times of a case"
        raise CaseError("KIND", "", KIND, what)


DOMAIN = Control()
