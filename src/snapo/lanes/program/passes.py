"""Passes over a program: rewrite, share, drop.

Each pass takes a program and gives one that computes the same, with fewer or cheaper operations.
"""

import numpy as np

from .program import Op, Program, Value, constant


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
