"""How a policy is measured: how many paths each of its numbers has."""

from dataclasses import dataclass, replace
from typing import NamedTuple

from snapo.problem.actions.base import count
from snapo.problem.scenarios import Sobol, Sources

SCENARIOS = ("pseudo-random", "sobol")
SMALL = 4e6  # steps of paths, which take a second or so and are spent in any case
PURPOSES = 3  # the surface, its margin, the bumps
FEWEST = 512  # paths of a surface and of a margin
BACK = 4  # paths valued in the time of one path that is gone back over
PAIR = 2  # coordinates that a surface has in any case


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
    selection_paths: int = 16384
    scenarios: str = "pseudo-random"

    def __post_init__(self):
        if self.scenarios not in SCENARIOS:
            allowed = " or ".join(map(repr, SCENARIOS))
            raise ValueError(f"Evaluation: scenarios is {self.scenarios!r}; allowed is {allowed}.")
        for name in MINIMUM:
            count(f"Evaluation: {name}", getattr(self, name), MINIMUM[name])

    def sources(self, seed: int) -> Sources:
        """Fresh scenarios for every role, those of the evaluation as they are asked for here."""
        fresh = Sources.of(None, seed)
        return replace(fresh, evaluation=Sobol(seed)) if self.scenarios == "sobol" else fresh


MINIMUM = {
    "paths": 2, "sensitivity_paths": 0, "smooth_paths": 0, "judge_paths": 0, "search_paths": 0,
    "selection_paths": 0,
}  # fmt: skip


class Effort(NamedTuple):
    """How many paths the derivatives of a policy may take beside its training.

    The unit is one path that is valued. A training has valued and gone back over `steps * paths` of
    them; the surface around the policy, its margin and the bumps each value a third as many paths,
    and more where a path is short. The numbers follow the problem and the settings alone, never a
    clock: a run that is repeated has the same bits.

    - `work`: the paths that may be valued for one purpose; `maximum`: paths on which it is done.
    """

    work: float
    maximum: int

    @classmethod
    def for_training(cls, trained: int, horizon: int, maximum: int) -> "Effort":
        """That of a training on so many paths in all, of so many steps each."""
        return cls(trained / PURPOSES + SMALL / max(horizon, 1), maximum)

    def valued(self, times: int) -> int:
        """Paths that can be valued so many times."""
        return self._within(self.work / max(times, 1))

    def gone_back(self, times: int) -> int:
        """Paths that can be gone back over so many times."""
        return self._within(self.work / (BACK * max(times, 1)))

    def _within(self, paths: float) -> int:
        return int(min(self.maximum, max(FEWEST, paths)))
