"""How the gradient of each shared array is brought together: outer products, and the rest."""

from dataclasses import dataclass

from ..program.cut import Leaf
from ..program.outer import Outer, outer_terms
from ..program.program import Program, ProgramValue


@dataclass(eq=False)
class GradientRule:
    """One shared array's gradient: outer products, and values to be summed element by element."""

    leaf: Leaf
    terms: list[Outer]
    rest: list[ProgramValue]

    @property
    def factors(self) -> list[ProgramValue]:
        return [v for t in self.terms for v in (t.rows, t.columns)]


@dataclass(eq=False)
class Gradients:
    """Those summed over the whole call's steps, and those of a step's own numbers."""

    items: list[GradientRule]

    def required(self) -> list[ProgramValue]:
        """Everything the reverse sweep must bring about."""
        return [v for g in self.items for v in g.rest] + [v for g in self.items for v in g.factors]

    def stored(self, later: set[ProgramValue]) -> set[ProgramValue]:
        """Factors that the forward sweep must store; `later` belongs to the reverse sweep."""
        return {v for g in self.items for v in g.factors if v not in later}


def plan(program: Program, leaves: list[Leaf], outputs: list[ProgramValue]) -> Gradients:
    """How each gradient is brought together."""
    pairs = zip(leaves, outputs)
    return Gradients([GradientRule(leaf, *outer_terms(program, value)) for leaf, value in pairs])
