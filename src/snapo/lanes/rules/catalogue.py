"""The rule of each primitive that is not elementwise."""

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
