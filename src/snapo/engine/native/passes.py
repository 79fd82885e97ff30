"""Passes over a program: rewrite, share, drop, and decide what the reverse sweep reads from a tape.

Each pass takes a program and gives one that computes the same, with fewer or cheaper operations.
"""

from dataclasses import dataclass

import numpy as np

from .program import Op, Program, Value, constant

# Worth storing rather than computing again: everything that costs more than a load from cache.
EXPENSIVE = {
    "dot_general", "exp", "exp2", "log", "log1p", "expm1", "tanh", "logistic", "sin", "cos", "tan",
    "pow", "sqrt", "rsqrt", "cbrt", "erf", "erfc", "atan2", "atan", "asin", "acos", "sinh",
    "cosh", "asinh", "acosh", "atanh", "sort", "searchsorted", "cumsum", "cumprod", "cummax",
    "cummin", "gather", "dynamic_slice", "lgamma", "digamma",
}  # fmt: skip
REDUCTIONS = {"reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "argmax", "argmin"}
BIG = 12  # arrays of more numbers than this live in memory, smaller ones in registers


def optimize(program: Program) -> Program:
    """Rewrites, shares and drops, in that order."""
    return drop(share(rewrite(program)))


def rewrite(program: Program) -> Program:
    """Peepholes: divisions that are not needed, selects that choose between known numbers."""
    maker: dict[Value, Op] = {}
    ops = []
    for op in program.ops:
        op = _multiply_instead(op, maker, ops)
        ops.append(op)
        maker.update((v, op) for v in op.outputs)
    return Program(program.inputs, ops, program.outputs)


def _multiply_instead(op: Op, maker: dict[Value, Op], ops: list[Op]) -> Op:
    """x / c becomes x * (1 / c) for a known c, and so does x / select(mask, 1, 2).

    The latter is how JAX shares the derivative of max and min between equal arguments. The
    result differs from a division by at most one unit in the last place.
    """
    if op.name != "div" or not op.outputs[0].floating:
        return op
    x, divisor = op.inputs
    inverse = _inverse(divisor)
    if inverse is not None:
        return Op("mul", [x, inverse], op.outputs, {}, op.where)
    choice = maker.get(divisor)
    if choice is not None and choice.name == "select_n":
        options = [_inverse(v) for v in choice.inputs[1:]]
        if all(v is not None for v in options):
            chosen = Value(divisor.shape, divisor.dtype, divisor.path)
            inputs = [choice.inputs[0], *options]
            ops.append(Op("select_n", inputs, [chosen], {}, op.where))  # pyright: ignore
            return Op("mul", [x, chosen], op.outputs, {}, op.where)
    return op


def _inverse(value: Value) -> Value | None:
    """1 / value, where it is known and neither it nor its inverse is near the ends of the range."""
    known = value.constant
    if known is None or not np.all(np.isfinite(known)) or np.any(known == 0):
        return None
    if np.any(np.abs(np.log2(np.abs(known.astype(np.float64)))) > 100):
        return None
    return constant((1 / known).astype(known.dtype))


def share(program: Program) -> Program:
    """Common subexpressions: one computation of each operation on the same inputs."""
    replaced: dict[Value, Value] = {}
    known: dict[tuple, Op] = {}
    ops = []
    for op in program.ops:
        inputs = [replaced.get(v, v) for v in op.inputs]
        key = (op.name, tuple(map(_identity, inputs)), _signature(op))
        first = known.get(key)
        if first is not None:
            replaced.update(zip(op.outputs, first.outputs))
            continue
        known[key] = op = Op(op.name, inputs, op.outputs, op.params, op.where)
        ops.append(op)
    return Program(program.inputs, ops, [replaced.get(v, v) for v in program.outputs])


def _identity(value: Value):
    if value.constant is None:
        return id(value)
    return (value.dtype.str, value.shape, value.constant.tobytes())


def _signature(op: Op) -> tuple:
    skipped = {"sharding", "out_sharding", "jaxpr", "name"}
    shapes = tuple((v.shape, v.dtype.str) for v in op.outputs)
    return shapes, tuple(sorted((k, str(v)) for k, v in op.params.items() if k not in skipped))


def drop(program: Program) -> Program:
    """Dead code: operations whose outputs nobody reads."""
    live = set(program.outputs)
    ops = []
    for op in reversed(program.ops):
        if any(v in live for v in op.outputs):
            live.update(op.inputs)
            ops.append(op)
    return Program(program.inputs, ops[::-1], program.outputs)


@dataclass(eq=False)
class Plan:
    """A joint program divided in two sweeps.

    - `forward`: the primal operations that the piece's outputs and the tape need.
    - `reverse`: the operations of the reverse sweep, recomputation included.
    - `tape`: primal values that the forward sweep stores and the reverse sweep reads.
    """

    forward: list[Op]
    reverse: list[Op]
    tape: list[Value]


def plan(
    program: Program,
    cotangents: list[Value],
    primal: list[Value],
    back: list[Value],
    kept: set[Value],
) -> Plan:
    """Decides what is stored and what is computed again.

    `primal` are the outputs of the forward sweep, `back` those of the reverse sweep, and
    `cotangents` the inputs that only the reverse sweep has. Dot products, curves and noise are
    stored; cheap arithmetic is done again from what is stored. `kept` are stored in any case.
    """
    maker = {v: op for op in program.ops for v in op.outputs}
    later = dependents(program, cotangents)
    reverse: set[Op] = set()
    tape: dict[Value, None] = {}
    stack, seen = list(back), set()
    while stack:
        v = stack.pop()
        if v in seen or v.constant is not None:
            continue
        seen.add(v)
        op = maker.get(v)
        if v not in later and v.path and (op is None or costly(op) or v in kept):
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
    return Plan(forward[::-1], [op for op in program.ops if op in reverse], list(tape))


def dependents(program: Program, sources: list[Value]) -> set[Value]:
    """Everything that depends on the sources, themselves included."""
    found = set(sources)
    for op in program.ops:
        if any(v in found for v in op.inputs):
            found.update(op.outputs)
    return found


def costly(op: Op) -> bool:
    """Whether storing the result beats computing it again."""
    return op.name in EXPENSIVE or (op.name in REDUCTIONS and op.inputs[0].size > BIG)


@dataclass(eq=False)
class Outer:
    """A term of a matrix's gradient: the product of two vectors, summed over paths and steps."""

    rows: Value
    columns: Value


def outer_terms(program: Program, gradient: Value) -> tuple[list[Outer], list[Value]]:
    """Splits a gradient that will be summed over paths into outer products and everything else.

    Looks through sums and transpositions; what is left must be computed path by path.
    """
    maker = {v: op for op in program.ops for v in op.outputs}
    terms: list[Outer] = []
    rest: list[Value] = []

    def visit(value: Value) -> None:
        op = maker.get(value)
        if op is not None and op.name == "add_any":
            products, first = len(terms), len(rest)
            for v in op.inputs:
                visit(v)
            if len(terms) == products:  # no product inside: the sum is less to keep than its parts
                rest[first:] = [value]
        elif op is not None and op.name == "reshape":
            visit(op.inputs[0])
        elif op is not None and op.name == "transpose" and op.params["permutation"] == (1, 0):
            source = maker.get(op.inputs[0])
            if source is None or not is_outer(source) or len(source.inputs[0].shape) != 1:
                rest.append(value)
            else:
                terms.append(Outer(*reversed(source.inputs)))
        elif op is not None and is_outer(op):
            terms.append(Outer(*op.inputs))
        elif value.constant is None or np.any(value.constant):
            rest.append(value)

    visit(gradient)
    return terms, rest


def is_outer(op: Op) -> bool:
    """A dot product that contracts nothing, of two arrays that differ between paths."""
    if op.name != "dot_general" or not all(v.path for v in op.inputs):
        return False
    (contract, _), (batch, _) = op.params["dimension_numbers"]
    return not contract and not batch and op.outputs[0].size > BIG
