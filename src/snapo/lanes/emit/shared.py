"""Arrays that all paths share: those of the whole call, and those of one step."""

from dataclasses import dataclass

from ..program.cut import Leaf
from .storage import ArrayPlace, Layout


@dataclass(frozen=True)
class Shared:
    """Two rows of memory, the call's and the present step's, and the arrays in them by leaf.

    `call_row` and `step_row` are the rows' addresses; without a step only the call's is there.
    """

    call: Layout
    step: Layout
    call_row: str
    step_row: str | None = None

    def of_call(self, leaf: Leaf) -> bool:
        """Whether an array belongs to the whole call."""
        return leaf in self.call.fields

    def address(self, leaf: Leaf, invariant: bool = False) -> ArrayPlace:
        """Where an array lies; `invariant` promises that nothing writes there meanwhile."""
        if self.of_call(leaf):
            return self.call.address(leaf, self.call_row, invariant)
        assert self.step_row is not None
        return self.step.address(leaf, self.step_row, invariant)
