"""Derivatives of attributes with respect to inputs, in the cheaper of two modes, and of second
order."""

from typing import Literal, NamedTuple

import numpy as np

from ..flowsheet.process import PharmaProcess
from ..given import Entry
from .mode import DERIVATIVES, Mode

# Cost of an adjoint pass in forward tangents, both without the run that they share: measured on the
# process of `snapo new pharma`. It is higher for a unit with many states.
ADJOINT_COST = 1.1


class Jacobian(NamedTuple):
    """[Q, E] `jacobian`: the case's unit of the attribute per DOMAIN unit of the entry.

    `values`: [Q]; `mode`: "adjoint" or "forward", and the `reason` for it; `passes`: adjoint
    passes or forward tangents that were run.
    """

    values: np.ndarray
    jacobian: np.ndarray
    mode: Mode
    reason: str
    passes: int


def matrix(
    process: PharmaProcess,
    inputs=None,
    entries: tuple[Entry, ...] | None = None,
    attributes: tuple[str, ...] | None = None,
    mode: Literal["auto", "adjoint", "forward"] = "auto",
) -> Jacobian:
    """Derivatives of all attributes with respect to entries, by default the case's parameters."""
    entries = process.entries if entries is None else tuple(entries)
    names = process.names if attributes is None else tuple(attributes)
    rows = np.array([process.names.index(name) for name in names], int)
    mode, reason = choose(process, len(rows), len(entries), mode)
    derivative = DERIVATIVES[mode]

    def make(local: bool):
        def of_entries(numbers, inputs):
            attribute = process.attributes(
                process.shifted(numbers, entries, inputs), nominal_steps=local
            )[rows]
            return attribute, attribute

        return derivative(of_entries, has_aux=True)

    jacobian, values = process.either(
        ("matrix", entries, names, mode),
        make,
        process.at(entries, inputs),
        process.nominal_inputs(inputs),
    )
    passes = len(rows) if mode == "adjoint" else len(entries)
    return Jacobian(values, jacobian, mode, reason, passes)


def choose(
    process: PharmaProcess, rows: int, columns: int, mode: Literal["auto", "adjoint", "forward"]
) -> tuple[Mode, str]:
    """The cheaper mode of differentiation, by the numbers of passes, and the reason as text."""
    adjoint, forward = ADJOINT_COST * rows, float(columns)
    if process.case.numerics.method == "adaptive":
        if mode == "forward":
            raise ValueError("Adaptive integration has no forward mode; use the adjoint.")
        return "adjoint", "adaptive integration is differentiated by its adjoint"
    if mode != "auto":
        return mode, f"{mode} mode was asked for"
    selected = "adjoint" if adjoint < forward else "forward"
    counted = f"{rows} adjoint passes cost about as much as {adjoint:.3g} forward passes"
    return selected, f"{counted}; forward mode needs {columns} of these"


def gradient(process: PharmaProcess, attribute: str, inputs=None) -> dict[str, np.ndarray]:
    """Derivatives of one attribute with respect to every entry of every input, per domain unit,
    from ONE adjoint pass."""
    row = process.names.index(attribute)

    def make(local: bool):
        return DERIVATIVES["adjoint"](
            lambda values: process.attributes(values, nominal_steps=local)[row]
        )

    return process.either(("gradient", row), make, process.nominal_inputs(inputs))


def second(
    process: PharmaProcess, pairs: tuple[tuple[Entry, Entry], ...], inputs=None
) -> np.ndarray:
    """[pairs, Q] mixed second derivatives of every attribute, forward over reverse."""
    if process.case.numerics.method == "adaptive":
        raise ValueError("Second derivatives need a fixed mesh; use method 'mesh'.")
    entries = tuple(dict.fromkeys(item for pair in pairs for item in pair))

    def make(local: bool):
        def of_entries(numbers, inputs):
            return process.attributes(
                process.shifted(numbers, entries, inputs), nominal_steps=local
            )

        return DERIVATIVES["forward"](DERIVATIVES["adjoint"](of_entries))

    hessian = process.either(
        ("second", entries), make, process.at(entries, inputs), process.nominal_inputs(inputs)
    )
    return np.stack([hessian[:, entries.index(a), entries.index(b)] for a, b in pairs])
