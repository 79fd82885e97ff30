"""Operations that only move numbers: each is one `Gather`, of places that JAX itself finds.

The operation is carried out on the numbers of places, 0, 1, 2 …, in place of its data; what comes
out says where every number of the result comes from.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from .graph import Graph, Tensor

# {operation: which of its operands are data}; the others, such as indices, must be constants.
MOVES = {
    "gather": (0,), "dynamic_slice": (0,), "rev": (0,), "split": (0,),
    "scatter": (0, 2), "dynamic_update_slice": (0, 1),
}  # fmt: skip


def moved(graph: Graph, equation: Any, given: list[Tensor]) -> list[Tensor]:
    """The outputs of one such operation.

    **Raises:** `ValueError` where an index depends on the observation, or leaves its array.
    """
    data = MOVES[equation.primitive.name]
    operands, first, start = [], [], 0
    for i, each in enumerate(given):
        if i in data:
            size = int(np.prod(each.shape, dtype=int))
            operands.append(jnp.arange(start, start + size).reshape(each.shape))
            first.append(graph.reshaped(each, (size,)))
            start += size
        elif each.name in graph.constants:
            operands.append(jnp.asarray(graph.constants[each.name]))
        else:
            raise ValueError("to_onnx: an index that depends on the observation is not exported.")
    settings = dict(equation.params)
    if settings.get("fill_value", 0) is not None and "fill_value" in settings:
        settings["fill_value"] = None
    found = equation.primitive.bind(*operands, **settings)
    places = found if equation.primitive.multiple_results else [found]
    batched = any(each.batched for each in first)
    flat = first[0]
    if len(first) > 1:
        parts = [graph.by_state(each) for each in first] if batched else first
        flat = graph.node("Concat", parts, (start,), parts[0].dtype, axis=int(batched))
    return [_taken(graph, flat, np.asarray(each), start) for each in places]


def _taken(graph: Graph, flat: Tensor, places: np.ndarray, count: int) -> Tensor:
    if places.size and not (places.min() >= 0 and places.max() < count):
        raise ValueError("to_onnx: an index lies outside of its array.")
    index = graph.constant(places.astype(np.int64))
    return graph.node("Gather", [flat, index], places.shape, flat.dtype, axis=int(flat.batched))
