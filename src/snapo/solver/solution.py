"""The result of `solve`: frozen data that says what was found, how, and how far to trust it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from snapo.problem.policy import Policy

from . import checkpoint
from .files import write_csv, write_text
from .sensitivity import Row, Sensitivities
from .train import Record

POLICY, SENSITIVITIES, HISTORY, RESULT = (
    "policy.npz",
    "sensitivities.csv",
    "history.csv",
    "result.json",
)


@dataclass(frozen=True)
class Solution:
    """What `solve` found.

    - `value`, `standard_error`: the objective of the EXACT simulator on fresh scenarios.
    - `smooth_value`, `smoothing_gap`: the smooth simulator on the same paths, and exact - smooth.
    - `policy`: the trained policy; `policy_gradient_norm`: it vanishes at an optimum.
    - `sensitivities`: held and smooth derivatives by every input, with standard errors.
    - `totals`: {output: [paths]} of the exact simulator; `history`: of the training.
    - `seconds`: {compile, train, evaluate, total}; `engine` and `reason`: which one and why.
    - `status`: "trained", "stopped early" or "diverged".
    """

    value: float
    standard_error: float
    smooth_value: float
    smoothing_gap: float
    policy: Policy
    policy_gradient_norm: float
    sensitivities: Sensitivities | None
    totals: Mapping[str, np.ndarray]
    history: tuple[Record, ...]
    seconds: Mapping[str, float]
    engine: str
    reason: str
    paths: Mapping[str, int]
    seed: int
    status: str
    control: float = 0.0
    halfway: Policy | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        gap = f"smooth {self.smooth_value:,.4g}, gap {self.smoothing_gap:,.3g}"
        seconds = ", ".join(f"{name} {value:.1f} s" for name, value in self.seconds.items())
        return "\n".join(
            [
                f"value {self.value:,.6g} ± {self.standard_error:,.3g} ({gap}), {self.status}",
                f"engine {self.engine}: {self.reason}",
                f"paths {self.paths}, seed {self.seed}; {seconds}",
            ]
        )

    def summary(self) -> dict[str, Any]:
        """The result as plain data, for JSON."""
        return {
            "value": self.value,
            "standard_error": self.standard_error,
            "smooth_value": self.smooth_value,
            "smoothing_gap": self.smoothing_gap,
            "policy_gradient_norm": self.policy_gradient_norm,
            "seconds": dict(self.seconds),
            "engine": self.engine,
            "paths": dict(self.paths),
            "seed": self.seed,
            "status": self.status,
        }

    def save(self, folder: Path | str) -> None:
        """Writes result.json, sensitivities.csv, history.csv and the policy's numbers."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        extra = {"reason": self.reason, "control": self.control, "versions": dict(self.versions)}
        write_text(folder / RESULT, json.dumps(self.summary() | extra, indent=1))
        if self.sensitivities is not None:
            write_csv(folder / SENSITIVITIES, Row._fields, self.sensitivities.rows())
        write_csv(folder / HISTORY, Record._fields, self.history)
        checkpoint.save_arrays(folder / POLICY, self.policy, {"versions": dict(self.versions)})


def load_policy(folder: Path | str, like: Policy) -> Policy:
    """The trained policy of a run folder; `like` is a policy of the same shape."""
    return checkpoint.load_arrays(Path(folder) / POLICY, like)[0]
