"""`snapo.to_onnx` and `snapo.decision_table`: exact decisions as an ONNX graph or as a table."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..code.version import of_policy, read_context
from ..policy import Policy
from ..policy import features as features_of
from ..smooth import Exact
from .rules import RULES, Graph, Tensor, unrolled, unstacked


class TableDecisions(NamedTuple):
    """`x` [n, 2], the two varied numbers, and `action` [n, size], the exact decision there."""

    x: Float[np.ndarray, "n 2"]
    action: Float[np.ndarray, "n size"]


def decision_table(
    policy: Policy,
    file: Path | str | None = None,
    *,
    x: tuple[int, Sequence[float]],
    y: tuple[int, Sequence[float]],
    at: Sequence[float],
    names: Sequence[str] | None = None,
    observe: Callable[[Any], Any] | None = None,
) -> TableDecisions:
    """The exact decision at every pair of values of two observed numbers; x varies slowest.

    **Arguments:**

    - `file`: a CSV to write, a row for each pair; None: the table is only returned.
    - `x`, `y`: the index of the varied number, from 0, and its values.
    - `at`: all numbers of one observation; those of `x` and `y` are replaced.
    - `names`: the names of the columns: the two numbers, then those of the action.
    - `observe`: a function from raw numbers to one observation; `at`, `x` and `y` are then raw
      numbers.

    >>> rule = snapo.Linear([[1.0, 10.0]])
    >>> snapo.decision_table(rule, x=(0, [0, 1]), y=(1, [2, 3]), at=[0, 0]).action.tolist()
    [[20.0], [30.0], [21.0], [31.0]]
    """
    (one, values), (two, others) = x, y
    if one == two or not all(0 <= item < len(at) for item in (one, two)):
        message = f"the indices of x and y must be two different numbers from 0 to {len(at) - 1}"
        raise ValueError(f"decision_table: {message}; got {one} and {two}.")
    pairs = np.array([(a, b) for a in values for b in others], np.float64).reshape(-1, 2)
    states = np.tile(np.asarray(at, np.float64), (len(pairs), 1))
    states[:, [one, two]] = pairs
    version = of_policy(policy, states, observe)
    with jax.enable_x64(True), read_context(version):
        action = np.asarray(decided(policy, observe, jnp.asarray(states)), np.float64)
    table = TableDecisions(pairs, action)
    if file is not None:
        _write(Path(file), table, names or _names(one, two, action.shape[1]))
    return table


@eqx.filter_jit
def decided(policy: Policy, observe: Any, states: Float[Array, "n features"]) -> Array:
    """The exact decision at every state."""

    def one(raw: Array) -> Array:
        return policy(raw if observe is None else jnp.asarray(observe(raw)), Exact())

    return jax.vmap(one)(states)


def _names(one: int, two: int, size: int) -> list[str]:
    return [f"observation {one}", f"observation {two}", *(f"action {i}" for i in range(size))]


def _write(file: Path, table: TableDecisions, names: Sequence[str]) -> None:
    rows = np.concatenate([table.x, table.action], axis=1)
    if len(names) != rows.shape[1]:
        message = f"names has {len(names)} entries, but the table has {rows.shape[1]} columns"
        raise ValueError(f"decision_table: {message}.")
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([repr(float(item)) for item in row] for row in rows)


# {operation: which of its operands are data}; the others, such as indices, must be constants.
MOVES = {
    "gather": (0,), "dynamic_slice": (0,), "rev": (0,), "split": (0,),
    "scatter": (0, 2), "dynamic_update_slice": (0, 1),
}  # fmt: skip


def translated(graph: Graph, equation: Any, tensors: list[Tensor]) -> list[Tensor]:
    """The outputs of an operation of `MOVES`.

    **Raises:** `ValueError` if an index depends on the observation, or is outside its array.
    """
    data = MOVES[equation.primitive.name]
    operands, first, start = [], [], 0
    for i, item in enumerate(tensors):
        if i in data:
            size = int(np.prod(item.shape, dtype=int))
            operands.append(jnp.arange(start, start + size).reshape(item.shape))
            first.append(graph.reshaped(item, (size,)))
            start += size
        elif item.name in graph.constants:
            operands.append(jnp.asarray(graph.constants[item.name]))
        else:
            raise ValueError("to_onnx: an index that depends on the observation is not exported.")
    settings = dict(equation.params)
    if settings.get("fill_value", 0) is not None and "fill_value" in settings:
        settings["fill_value"] = None
    result = equation.primitive.bind(*operands, **settings)
    positions = result if equation.primitive.multiple_results else [result]
    batched = any(entry.batched for entry in first)
    flat = first[0]
    if len(first) > 1:
        parts = [graph.by_state(value) for value in first] if batched else first
        flat = graph.node("Concat", parts, (start,), parts[0].dtype, axis=int(batched))
    return [_taken(graph, flat, np.asarray(position), start) for position in positions]


def _taken(graph: Graph, flat: Tensor, positions: np.ndarray, count: int) -> Tensor:
    if positions.size and not (positions.min() >= 0 and positions.max() < count):
        raise ValueError("to_onnx: an index is outside of its array.")
    index = graph.constant(positions.astype(np.int64))
    return graph.node("Gather", [flat, index], positions.shape, flat.dtype, axis=int(flat.batched))


INLINED = {
    "jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "remat": "jaxpr",
    "checkpoint": "jaxpr", "custom_vjp_call_jaxpr": "fun_jaxpr",
}  # fmt: skip


def to_onnx(
    policy: Policy,
    file: Path | str | None = None,
    *,
    features: int | None = None,
    observe: Callable[[Any], Any] | None = None,
    dtype: Literal["float32", "float64"] = "float32",
) -> Any:
    """The policy as an ONNX model: `observation` [states, features] to `action` [states, size].

    The decision is that of the exact simulator: whole numbers, stop or continue, one option. The
    graph follows the JAX trace of the policy, so that user-defined classes can be exported too.

    **Arguments:**

    - `file`: the file for the model; None: the model is only returned.
    - `features`: the length of an observation; by default that of the policy's network.
    - `observe`: a function from one vector of raw numbers to one observation, such as
      `lambda raw: (raw - 50) / 20`. It becomes part of the graph, and `features` counts the raw
      numbers.
    - `dtype`: the dtype of the graph. With either dtype the policy's weights are float32.

    **Returns:** the `onnx.ModelProto`, checked by onnx.

    **Raises:** `ValueError` if the policy uses an operation without a counterpart, which is named,
    or the number of features is unknown.
    """
    try:
        import onnx
    except ModuleNotFoundError:
        message = "snapo.to_onnx needs the package onnx: pip install 'snapo[onnx]'"
        raise ModuleNotFoundError(message) from None
    graph, action = traced_graph("to_onnx", policy, features, observe, dtype)
    model = graph.model(action, f"snapo policy {type(policy).__name__}, exact decisions")
    if file is not None:
        onnx.save(model, str(file))
    return model


def traced_graph(
    verb: str,
    policy: Policy,
    features: int | None,
    observe: Callable[[Any], Any] | None,
    dtype: Literal["float32", "float64"],
) -> tuple[Graph, Tensor]:
    """The exact decision of a policy as a graph, and its output.

    **Raises:** `ValueError` as `to_onnx` does.
    """
    count = features if observe is not None or features is not None else features_of(policy)
    if count is None:
        raise ValueError(
            f"{verb}: the number of features is unknown for this policy; specify features=, the "
            "length of one observation (with observe=, of one raw vector)."
        )
    graph = Graph(count, dtype)

    def decide(raw):
        observed = raw if observe is None else jnp.asarray(observe(raw), raw.dtype)
        return policy(observed, Exact()).astype(raw.dtype)

    with jax.enable_x64(dtype == "float64"):
        traced = jax.make_jaxpr(decide)(jax.ShapeDtypeStruct((count,), np.dtype(dtype)))
        (result,) = _written(graph, traced.jaxpr, traced.consts, [graph.input])
    return graph, graph.decided(result)


def _written(graph: Graph, jaxpr: Any, consts: Any, arguments: list[Tensor]) -> list[Tensor]:
    """The equations of a trace as nodes, one after another; returns the outputs."""
    tensors: dict[Any, Tensor] = dict(zip(jaxpr.invars, arguments))
    tensors |= {name: graph.constant(const) for name, const in zip(jaxpr.constvars, consts)}

    def value(atom: Any) -> Tensor:
        if hasattr(atom, "val"):
            return graph.constant(np.asarray(atom.val, atom.aval.dtype))
        return tensors[atom]

    for equation in jaxpr.eqns:
        values = [value(atom) for atom in equation.invars]
        operation = _operation(graph, equation, values)
        tensors |= dict(zip(equation.outvars, operation))
    return [value(atom) for atom in jaxpr.outvars]


def _operation(graph: Graph, equation: Any, tensors: list[Tensor]) -> list[Tensor]:
    name, settings = equation.primitive.name, equation.params
    available = [graph.constants.get(item.name) for item in tensors]
    if name not in INLINED and all(entry is not None for entry in available):
        return _folded(graph, equation, available)
    if name in INLINED:
        inner = settings[INLINED[name]]
        return _written(
            graph, getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), tensors
        )
    if name == "scan":
        return unrolled(graph, settings, tensors, _written)
    if name == "unstack":
        return unstacked(graph, equation, tensors)
    if name in MOVES:
        return translated(graph, equation, tensors)
    if name not in RULES:
        raise ValueError(
            f"to_onnx: this policy uses the operation {name}, which is not exported; write it with "
            "sums, products, selections and the functions of jax.nn."
        )
    return [RULES[name](graph, equation, tensors)]


def _folded(graph: Graph, equation: Any, available: list[Any]) -> list[Tensor]:
    """The results of an equation that does not depend on the observation, as constants."""
    result = equation.primitive.bind(*map(jnp.asarray, available), **equation.params)
    result = result if equation.primitive.multiple_results else [result]
    return [graph.constant(np.asarray(item)) for item in result]
