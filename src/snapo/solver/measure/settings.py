"""How a policy is measured: how many paths each of its numbers has."""

from dataclasses import dataclass, replace

from snapo.problem.actions.base import count
from snapo.problem.scenarios import Sobol, Sources

SCENARIOS = ("pseudo-random", "sobol")


@dataclass(frozen=True)
class Evaluation:
    """How a policy is measured. Zero paths leave a number out.

    - `paths`: fresh scenarios for the value.
    - `sensitivity_paths`: for the derivatives with decisions held; `smooth_paths`: for those
      through the smooth policy.
    - `judge_paths`: at most, for bumps of every input, which the held derivatives are tested by.
    - `search_paths`: at most, for the value around the policy, which gives the part of every
      interval that is due to the policy.
    - `selection_paths`: at most, for the final choice between the policies of a training and the
      rule that it began with; never more than `paths`.
    - `scenarios`: "pseudo-random" (antithetic) or "sobol".
    """

    paths: int = 65536
    sensitivity_paths: int = 16384
    smooth_paths: int = 4096
    judge_paths: int = 16384
    search_paths: int = 16384
    selection_paths: int = 65536
    scenarios: str = "pseudo-random"

    def __post_init__(self):
        if self.scenarios not in SCENARIOS:
            allowed = " or ".join(map(repr, SCENARIOS))
            raise ValueError(f"Evaluation: scenarios is {self.scenarios!r}; allowed is {allowed}.")
        for name in LEAST:
            count(f"Evaluation: {name}", getattr(self, name), LEAST[name])

    def sources(self, seed: int) -> Sources:
        """Fresh scenarios for every role, those of the evaluation as they are asked for here."""
        fresh = Sources.of(None, seed)
        return replace(fresh, evaluation=Sobol(seed)) if self.scenarios == "sobol" else fresh


LEAST = {
    "paths": 2, "sensitivity_paths": 0, "smooth_paths": 0, "judge_paths": 0, "search_paths": 0,
    "selection_paths": 0,
}  # fmt: skip
