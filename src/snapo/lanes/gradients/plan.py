"""How the gradient of each shared array is brought together: outer products, and the rest."""

from dataclasses import dataclass

from ..program.cut import Leaf
from ..program.outer import Outer, outer_terms
from ..program.program import Program, Value


@dataclass(eq=False)
class Gradient:
    """One shared array's gradient: outer products, and values to be summed element by element."""

    leaf: Leaf
    terms: list[Outer]
    rest: list[Value]

    @property
    def factors(self) -> list[Value]:
        return [v for t in self.terms for v in (t.rows, t.columns)]


@dataclass(eq=False)
class Gradients:
    """Those summed over the whole call's steps, and those of a step's own numbers."""

    items: list[Gradient]

    def required(self) -> list[Value]:
        """Everything the reverse sweep must bring about."""
        return [v for g in self.items for v in g.rest] + [v for g in self.items for v in g.factors]

    def stored(self, later: set[Value]) -> set[Value]:
        """Factors that the forward sweep must store; `later` belongs to the reverse sweep."""
        return {v for g in self.items for v in g.factors if v not in later}


def plan(program: Program, leaves: list[Leaf], outputs: list[Value]) -> Gradients:
    """How each gradient is brought together."""
    pairs = zip(leaves, outputs)
    return Gradients([Gradient(leaf, *outer_terms(program, value)) for leaf, value in pairs])
