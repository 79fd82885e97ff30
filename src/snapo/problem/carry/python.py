"""`snapo.to_python`: exact decisions as a Python module that needs nothing but NumPy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..policy import Policy
from .export import traced_graph
from .rules import Graph, GraphNode

INFIX = {
    "Add": "+", "Sub": "-", "Mul": "*", "Div": "/", "Pow": "**", "Greater": ">", "Less": "<",
    "GreaterOrEqual": ">=", "LessOrEqual": "<=", "Equal": "==", "And": "&", "Or": "|",
    "MatMul": "@",
}  # fmt: skip
FUNCTIONS = {
    "Max": "np.maximum", "Min": "np.minimum", "Neg": "-", "Abs": "np.abs", "Exp": "np.exp",
    "Log": "np.log", "Tanh": "np.tanh", "Sqrt": "np.sqrt", "Sign": "np.sign", "Floor": "np.floor",
    "Ceil": "np.ceil", "Sin": "np.sin", "Cos": "np.cos", "Not": "~", "Round": "np.round",
    "Reciprocal": "1 / ", "Where": "np.where", "Sigmoid": "_sigmoid", "Erf": "_erf",
    "Identity": "",
}  # fmt: skip
REDUCED = {
    "ReduceSum": "np.sum", "ReduceMax": "np.max", "ReduceMin": "np.min", "ReduceProd": "np.prod",
}  # fmt: skip
HEAD = '''\
"""The exact decisions of a policy of snapo ({kind}); this file needs only NumPy.

    action = decide(observation)  # [{features}] numbers, or [states, {features}]
"""

from math import erf

import numpy as np
from numpy import array, inf, nan

_erf = np.vectorize(erf, otypes=[float])


def _sigmoid(x):
    return 1 / (1 + np.exp(-x))


'''
DECIDE = '''\


def decide(observation):
    """The action [{size}] at an observation [{features}], or one for each row of several."""
    states = np.asarray(observation, "{dtype}")
    observation = np.atleast_2d(states)
    if observation.shape[1] != {features}:
        got = observation.shape[1]
        raise ValueError(f"an observation has {features} numbers, but got {{got}}")
    with np.errstate(all="ignore"):
{lines}
    return action[0] if states.ndim == 1 else action
'''


def to_python(
    policy: Policy,
    file: Path | str | None = None,
    *,
    features: int | None = None,
    observe: Callable[[Any], Any] | None = None,
    dtype: Literal["float32", "float64"] = "float64",
) -> str:
    """The policy as the text of a Python module with `decide(observation)`, which needs NumPy only.

    The decision is that of the exact simulator; the arguments are those of `to_onnx`.

    **Returns:** the text. **Raises:** `ValueError` if the policy uses an operation that cannot
    be exported, which is named, or the number of features is unknown.
    """
    graph, action = traced_graph("to_python", policy, features, observe, dtype)
    numbers = {"features": graph.input.shape[0], "size": action.shape[0], "dtype": dtype}
    constants = [f"{name} = {_literal(item)}\n" for name, item in graph.used_constants().items()]
    lines = "\n".join(f"        {node.output} = {_expression(graph, node)}" for node in graph.nodes)
    head = HEAD.format(kind=type(policy).__name__, **numbers)
    text = head + "".join(constants) + DECIDE.format(lines=lines, **numbers)
    if file is not None:
        Path(file).write_text(text, encoding="utf-8")
    return text


def _literal(value: np.ndarray) -> str:
    """All digits of the numbers; nested lists, a row on each line."""
    text = repr(value.tolist()).replace("], [", "],\n    [")
    return f'array({text}, "{value.dtype.name}").reshape({value.shape})'


def _expression(graph: Graph, node: GraphNode) -> str:
    """One operation of ONNX in NumPy."""
    kind, inputs, settings = node.kind, node.inputs, node.settings
    if kind == "Div" and not np.issubdtype(node.dtype, np.floating):
        raise ValueError("to_python: a division of whole numbers is not exported.")
    if kind in INFIX:
        return f" {INFIX[kind]} ".join(inputs)
    if kind in FUNCTIONS:
        return f"{FUNCTIONS[kind]}({', '.join(inputs)})"
    if kind in REDUCED:
        return f"{REDUCED[kind]}({inputs[0]}, axis={_integers(graph, inputs[1])})"
    match kind:
        case "Cast":
            return f'{inputs[0]}.astype("{settings["to"]}")'
        case "ArgMax":
            return f"np.argmax({inputs[0]}, axis={settings['axis']})"
        case "Concat":
            return f"np.concatenate([{', '.join(inputs)}], axis={settings['axis']})"
        case "Transpose":
            return f"np.transpose({inputs[0]}, {tuple(settings['perm'])})"
        case "Gather":
            return f"np.take({', '.join(inputs)}, axis={settings['axis']})"
        case "Shape":
            return f"array({inputs[0]}.shape[{settings['start']} : {settings['end']}])"
        case "Expand":
            return f"{inputs[0]} * np.ones({inputs[1]}, {inputs[0]}.dtype)"
        case "Reshape":
            shape = ", ".join(
                f"{inputs[0]}.shape[{i}]" if size == 0 else str(size)
                for i, size in enumerate(_integers(graph, inputs[1]))
            )
            return f"{inputs[0]}.reshape(({shape}{',' if shape else ''}))"
        case "Slice":
            starts, ends, axes, strides = (_integers(graph, name) for name in inputs[1:])
            cut = ["slice(None)"] * (max(axes) + 1)
            for axis, start, end, stride in zip(axes, starts, ends, strides):
                cut[axis] = f"slice({start}, {end}, {stride})"
            return f"{inputs[0]}[({', '.join(cut)},)]"
    raise ValueError(f"to_python: the operation {kind} is not exported.")


def _integers(graph: Graph, name: str) -> tuple[int, ...]:
    """The numbers of a constant of shapes or axes."""
    return tuple(np.ravel(graph.constants[name]).tolist())
