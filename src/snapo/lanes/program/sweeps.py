"""The division of a joint program in two sweeps, and the tape between them."""

from dataclasses import dataclass

from .program import BIG, Op, Program, ProgramValue

# Worth storing rather than computing again: everything that costs more than a load from cache.
EXPENSIVE = {
    "dot_general", "exp", "exp2", "log", "log1p", "expm1", "tanh", "logistic", "sin", "cos", "tan",
    "pow", "sqrt", "rsqrt", "cbrt", "erf", "erfc", "atan2", "atan", "asin", "acos", "sinh",
    "cosh", "asinh", "acosh", "atanh", "sort", "searchsorted", "cumsum", "cumprod", "cummax",
    "cummin", "gather", "dynamic_slice", "lgamma", "digamma",
}  # fmt: skip
READS = {"gather", "dynamic_slice"}
REDUCTIONS = {"reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "argmax", "argmin"}


@dataclass(eq=False)
class SweepPlan:
    """A joint program divided in two sweeps.

    - `forward`: the primal operations that the piece's outputs and the tape need.
    - `reverse`: the operations of the reverse sweep, recomputation included.
    - `tape`: primal values that the forward sweep stores and the reverse sweep reads.
    """

    forward: list[Op]
    reverse: list[Op]
    tape: list[ProgramValue]


def plan(
    program: Program,
    cotangents: list[ProgramValue],
    primal: list[ProgramValue],
    back: list[ProgramValue],
    values: set[ProgramValue],
) -> SweepPlan:
    """Decides which values are stored and which are computed again.

    `primal` are the outputs of the forward sweep, `back` those of the reverse sweep, and
    `cotangents` the inputs that only the reverse sweep has. Dot products, curves and noise are
    stored; cheap arithmetic and reads in shared tables are repeated from stored values. `values`
    are stored in any case.
    """
    maker = {v: op for op in program.ops for v in op.outputs}
    later = dependents(program, cotangents)
    reverse: set[Op] = set()
    tape: dict[ProgramValue, None] = {}
    stack, observed = list(back), set()
    while stack:
        v = stack.pop()
        if v in observed or v.constant is not None:
            continue
        observed.add(v)
        op = maker.get(v)
        if v not in later and v.path and (op is None or stored(op) or v in values):
            tape[v] = None
        elif op is not None:
            reverse.add(op)
            stack.extend(op.inputs)
    needed = set(primal) | set(tape)
    forward = []
    for op in reversed(program.ops):
        if any(v in needed for v in op.outputs):
            needed.update(op.inputs)
            forward.append(op)
    return SweepPlan(forward[::-1], [op for op in program.ops if op in reverse], list(tape))


def dependents(program: Program, sources: list[ProgramValue]) -> set[ProgramValue]:
    """All values that depend on the sources, including the sources."""
    outputs = set(sources)
    for op in program.ops:
        if any(v in outputs for v in op.inputs):
            outputs.update(op.outputs)
    return outputs


def stored(op: Op) -> bool:
    """Whether the reverse sweep reads a result from the tape. A table that all paths share is read
    again: it is in the cache, and a long tape is not."""
    return costly(op) and (op.name not in READS or op.inputs[0].path)


def costly(op: Op) -> bool:
    """Whether storing the result is cheaper than computing it again."""
    return op.name in EXPENSIVE or (op.name in REDUCTIONS and op.inputs[0].size > BIG)
