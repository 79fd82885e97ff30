"""How many paths the derivatives of a policy may take beside its training.

The unit is one path that is valued. A training has valued and gone back over `steps * paths` of
them; the surface around the policy, its margin and the bumps each take about as much work, and a
little more where a path is short. The numbers follow the problem and the settings alone, never a
clock: a run that is repeated has the same bits.
"""

from typing import NamedTuple

SMALL = 4e6  # steps of paths, which take a second or so and are spent in any case
FEWEST = 512  # paths of a surface and of a margin
BACK = 4  # paths valued in the time of one path that is gone back over
PAIR = 2  # coordinates that a surface has in any case


class Effort(NamedTuple):
    """`work`: the paths that may be valued for one purpose; `most`: paths on which it is done."""

    work: float
    most: int

    @classmethod
    def beside(cls, trained: int, horizon: int, most: int) -> "Effort":
        """That of a training on so many paths in all, of so many steps each."""
        return cls(trained + SMALL / max(horizon, 1), most)

    def valued(self, times: int) -> int:
        """Paths that can be valued so many times."""
        return self._within(self.work / max(times, 1))

    def gone_back(self, times: int) -> int:
        """Paths that can be gone back over so many times."""
        return self._within(self.work / (BACK * max(times, 1)))

    def _within(self, paths: float) -> int:
        return int(min(self.most, max(FEWEST, paths)))
