"""One rule per kind of primitive: from an operation and the places of its inputs to LLVM IR."""

from collections.abc import Callable

from ..emit.values import EmittedValues
from ..program.program import Op
from . import arrays, dots, gathers, reductions, scatters, sorting

RULES: dict[str, Callable[[EmittedValues, Op], None]] = {
    **arrays.RULES,
    **reductions.RULES,
    **gathers.RULES,
    **scatters.RULES,
    **sorting.RULES,
    "dot_general": dots.dot,
}
