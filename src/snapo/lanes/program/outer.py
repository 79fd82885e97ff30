"""Outer products inside a gradient: the terms that need not be computed path by path."""

from dataclasses import dataclass

import numpy as np

from .program import BIG, Op, Program, ProgramValue


@dataclass(eq=False)
class Outer:
    """A term of a matrix's gradient: the product of two vectors, summed over paths and steps."""

    rows: ProgramValue
    columns: ProgramValue


def outer_terms(program: Program, gradient: ProgramValue) -> tuple[list[Outer], list[ProgramValue]]:
    """Splits a gradient that will be summed over paths into outer products and everything else.

    Looks through sums and transpositions; the rest must be computed path by path.
    """
    maker = {v: op for op in program.ops for v in op.outputs}
    terms: list[Outer] = []
    rest: list[ProgramValue] = []

    def visit(value: ProgramValue) -> None:
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
