"""Passes over a program: rewrite, share, drop.

Each pass turns a program into one that computes the same with fewer or cheaper operations.
"""

from dataclasses import replace

import numpy as np

from .program import Op, Program, ProgramValue, constant

Replaced = dict[ProgramValue, ProgramValue]


def optimize(program: Program, equal: Replaced | None = None) -> Program:
    """Applies the passes rewrite, share, fuse, simplify and drop in that order; `equal`: inputs
    that equal other ones."""
    return drop(simplify(fuse(share(rewrite(program), equal))))


def rewrite(program: Program) -> Program:
    """Peepholes: divisions that are not needed, selects that choose between known numbers."""
    maker: dict[ProgramValue, Op] = {}
    ops = []
    for op in program.ops:
        op = _multiply_instead(op, maker, ops)
        ops.append(op)
        maker.update((v, op) for v in op.outputs)
    return Program(program.inputs, ops, program.outputs)


def _multiply_instead(op: Op, maker: dict[ProgramValue, Op], ops: list[Op]) -> Op:
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
            value = ProgramValue(divisor.shape, divisor.dtype, divisor.path)
            inputs = [choice.inputs[0], *options]
            ops.append(Op("select_n", inputs, [value], {}, op.where))  # pyright: ignore
            return Op("mul", [x, value], op.outputs, {}, op.where)
    return op


def _inverse(value: ProgramValue) -> ProgramValue | None:
    """1 / value, if it is known and neither it nor its inverse is near the ends of the range."""
    available = value.constant
    if available is None or not np.all(np.isfinite(available)) or np.any(available == 0):
        return None
    if np.any(np.abs(np.log2(np.abs(available.astype(np.float64)))) > 100):
        return None
    return constant((1 / available).astype(available.dtype))


def share(program: Program, equal: Replaced | None = None) -> Program:
    """Computes common subexpressions once: each operation on the same inputs.

    An operation that reads an input in `equal` reads its equal one instead.
    """
    replaced: Replaced = dict(equal or {})
    available: dict[tuple, Op] = {}
    ops = []
    for op in program.ops:
        inputs = [replaced.get(v, v) for v in op.inputs]
        key = (op.name, tuple(map(_identity, inputs)), _signature(op))
        first = available.get(key)
        if first is not None:
            replaced.update(zip(op.outputs, first.outputs))
            continue
        available[key] = op = Op(op.name, inputs, op.outputs, op.params, op.where)
        ops.append(op)
    return Program(program.inputs, ops, [replaced.get(v, v) for v in program.outputs])


def _identity(value: ProgramValue):
    if value.constant is None:
        return id(value)
    return (value.dtype.str, value.shape, value.constant.tobytes())


def _signature(op: Op) -> tuple:
    skipped = {"sharding", "out_sharding", "jaxpr", "name"}
    shapes = tuple((v.shape, v.dtype.str) for v in op.outputs)
    return shapes, tuple(sorted((k, str(v)) for k, v in op.params.items() if k not in skipped))


def fuse(program: Program) -> Program:
    """Fuses products and the sums that read them to multiply-adds: `fma x y z` is x y + z.

    The choice depends only on the sum and the product. LLVM's choice depends on other readers of
    the product: two kernels with the same step, one with a policy and one with its recorded
    actions, would then differ in the last place. Cotangents are unchanged.
    """
    maker = {v: op for op in program.ops for v in op.outputs}
    ops = [_fused(op, maker) or op for op in program.ops]
    return Program(program.inputs, ops, program.outputs)


def _fused(op: Op, maker: dict[ProgramValue, Op]) -> Op | None:
    out = op.outputs[0]
    if op.name not in ("add", "sub") or not out.floating:
        return None
    first, second = op.inputs
    minus = op.name == "sub"
    for product, other, signs in (
        (first, second, {"minus_product": False, "minus_other": minus}),
        (second, first, {"minus_product": minus, "minus_other": False}),
    ):
        factors = _factors(maker.get(product))
        if factors is not None:
            return Op("fma", [*factors, other], op.outputs, signs, op.where)
    return None


def _factors(op: Op | None) -> list[ProgramValue] | None:
    """The two factors of a product or of a square."""
    if op is not None and op.name == "mul":
        return op.inputs
    squared = op is not None and (
        op.name == "square" or (op.name == "integer_pow" and op.params["y"] == 2)
    )
    return [*op.inputs, *op.inputs] if op is not None and squared else None


def simplify(program: Program) -> Program:
    """Removes products with one, and selections by constant masks.

    It runs after sums are fused, so that the last place of every number is unchanged.
    """
    replaced: Replaced = {}
    ops = []
    for op in program.ops:
        op = _without_one(replace(op, inputs=[replaced.get(v, v) for v in op.inputs]))
        if (value := _unchanged(op)) is not None:
            replaced[op.outputs[0]] = value
        else:
            ops.append(op)
    return Program(program.inputs, ops, [replaced.get(v, v) for v in program.outputs])


def _without_one(op: Op) -> Op:
    """A multiply-add as a sum or a difference, where one factor is one."""
    if op.name != "fma":
        return op
    first, second, other = op.inputs
    factors = [x for x, y in ((first, second), (second, first)) if _is(y, 1)]
    if not factors or factors[0].shape != op.outputs[0].shape:
        return op
    terms = [other, factors[0]] if op.params["minus_product"] else [factors[0], other]
    name = "sub" if any(op.params.values()) else "add"
    return Op(name, terms, op.outputs, {}, op.where)


def _unchanged(op: Op) -> ProgramValue | None:
    """The input that an operation returns unchanged: the other factor of a product with one, or the
    option that a known mask takes everywhere."""
    first, *others = op.inputs
    options: list[ProgramValue] = []
    if op.name == "mul":
        options = [x for x, y in ((first, others[0]), (others[0], first)) if _is(y, 1)]
    elif op.name == "select_n" and first.constant is not None and first.size:
        position = int(first.constant.flat[0])
        options = [others[position]] if _is(first, position) else []
    out = op.outputs[0]
    same = [x for x in options if (x.shape, x.dtype) == (out.shape, out.dtype)]
    return same[0] if same else None


def _is(value: ProgramValue, number: int) -> bool:
    """Whether all elements are known to be this number."""
    return value.constant is not None and bool(np.all(value.constant == number))


def drop(program: Program) -> Program:
    """Removes dead code: operations whose outputs are never read."""
    live = set(program.outputs)
    ops = []
    for op in reversed(program.ops):
        if any(v in live for v in op.outputs):
            live.update(op.inputs)
            ops.append(op)
    return Program(program.inputs, ops[::-1], program.outputs)
