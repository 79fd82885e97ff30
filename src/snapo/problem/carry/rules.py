"""Each operation of a JAX trace in ONNX. Axes count from the second: the first is states."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.lanes.jax_private import arguments_of_scan


class Tensor(NamedTuple):
    """A value in the graph: its name, its shape and type for ONE state, and whether it differs by
    state. Values without an axis of states are broadcast against those that have one."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype
    batched: bool


class GraphNode(NamedTuple):
    """One operation, named as in ONNX: the names of its inputs and of its output, and settings."""

    kind: str
    inputs: tuple[str, ...]
    output: str
    dtype: np.dtype
    settings: dict[str, Any]


class Graph:
    """Nodes and constants of a graph with one input, the observations [states, features]."""

    def __init__(self, features: int, dtype: Any):
        self.nodes: list[GraphNode] = []
        self.constants: dict[str, np.ndarray] = {}
        self.input = Tensor("observation", (features,), np.dtype(dtype), True)
        self._states: Tensor | None = None

    def constant(self, value: Any) -> Tensor:
        """A number or an array, the same for all states."""
        array = np.asarray(value)
        name = f"c{len(self.constants)}"
        self.constants[name] = array
        return Tensor(name, array.shape, array.dtype, False)

    def node(
        self, kind: str, inputs: Sequence[Tensor], shape: Sequence[int], dtype: Any, **settings: Any
    ) -> Tensor:
        """The output of one operation; it differs by state if any of its inputs does."""
        name, names = f"v{len(self.nodes)}", tuple(item.name for item in inputs)
        self.nodes.append(GraphNode(kind, names, name, np.dtype(dtype), settings))
        batched = any(entry.batched for entry in inputs)
        return Tensor(name, tuple(shape), np.dtype(dtype), batched)

    def integers(self, numbers: Sequence[int]) -> Tensor:
        """A constant of 64-bit integers, the type of shapes and axes."""
        return self.constant(np.array(numbers, np.int64))

    def reshaped(self, value: Tensor, shape: Sequence[int]) -> Tensor:
        """The same numbers in another shape."""
        target = self.integers([0, *shape] if value.batched else list(shape))
        return self.node("Reshape", [value, target], shape, value.dtype)

    def by_state(self, value: Tensor) -> Tensor:
        """The value with an axis of states."""
        if value.batched:
            return value
        if self._states is None:
            self._states = self.node("Shape", [self.input], (1,), np.int64, start=0, end=1)
            self._states = self._states._replace(batched=False)
        rest = self.integers(value.shape)
        target = self.node(
            "Concat", [self._states, rest], (1 + len(value.shape),), np.int64, axis=0
        )
        node = self.node("Expand", [value, target], value.shape, value.dtype)
        return node._replace(batched=True)

    def decided(self, result: Tensor) -> Tensor:
        """The output of the graph, "action" [states, size]."""
        value = self.by_state(result)
        self.nodes.append(GraphNode("Identity", (value.name,), "action", value.dtype, {}))
        return value._replace(name="action")

    def used_constants(self) -> dict[str, np.ndarray]:
        """The constants that an operation takes."""
        used = {name for node in self.nodes for name in node.inputs}
        return {name: constant for name, constant in self.constants.items() if name in used}

    def model(self, action: Tensor, about: str) -> Any:
        """The complete ONNX model, validated by the checker of onnx."""
        import onnx
        from onnx import helper, numpy_helper

        values, results = (
            helper.make_tensor_value_info(
                item.name, helper.np_dtype_to_tensor_dtype(item.dtype), ["states", *item.shape]
            )
            for item in (self.input, action)
        )
        nodes = []
        for node in self.nodes:
            settings = dict(node.settings)
            if node.kind == "Cast":
                settings["to"] = helper.np_dtype_to_tensor_dtype(np.dtype(settings["to"]))
            nodes.append(helper.make_node(node.kind, node.inputs, [node.output], **settings))
        constants = self.used_constants()
        tables = [numpy_helper.from_array(item, name) for name, item in constants.items()]
        graph = helper.make_graph(nodes, "policy", [values], [results], tables, about)
        # Of 2022 and 2023: runtimes of that age read the file.
        operators = [helper.make_opsetid("", 18)]
        model = helper.make_model(graph, producer_name="snapo", opset_imports=operators)
        model.ir_version = 8
        onnx.checker.check_model(model, full_check=True)
        return model


MAXIMUM = 64  # rounds of a loop that are written out

SAME = {
    "add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "max": "Max", "min": "Min",
    "pow": "Pow", "neg": "Neg", "abs": "Abs", "exp": "Exp", "log": "Log", "tanh": "Tanh",
    "logistic": "Sigmoid", "sqrt": "Sqrt", "sign": "Sign", "floor": "Floor", "ceil": "Ceil",
    "sin": "Sin", "cos": "Cos", "erf": "Erf", "gt": "Greater", "lt": "Less",
    "ge": "GreaterOrEqual", "le": "LessOrEqual", "eq": "Equal", "and": "And", "or": "Or",
    "not": "Not", "copy": "Identity", "stop_gradient": "Identity", "copy_p": "Identity",
}  # fmt: skip
REDUCED = {
    "reduce_sum": "ReduceSum", "reduce_max": "ReduceMax", "reduce_min": "ReduceMin",
    "reduce_prod": "ReduceProd",
}  # fmt: skip


def _out(equation: Any) -> tuple[tuple[int, ...], np.dtype]:
    aval = equation.outvars[0].aval
    return tuple(aval.shape), np.dtype(aval.dtype)


def _alike(graph: Graph, tensors: list[Tensor]) -> list[Tensor]:
    """Operands lined up for broadcasting, since some have no axis of states or fewer axes."""
    if not any(item.batched for item in tensors):
        return tensors
    rank = max(len(entry.shape) for entry in tensors)
    return [value if len(value.shape) == rank else _wider(graph, value, rank) for value in tensors]


def _wider(graph: Graph, tensor: Tensor, rank: int) -> Tensor:
    return graph.reshaped(tensor, (1,) * (rank - len(tensor.shape)) + tensor.shape)


def _same(kind: str) -> Callable:
    def rule(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
        return graph.node(kind, _alike(graph, tensors), *_out(equation))

    return rule


def _cast(graph: Graph, value: Tensor, dtype: Any) -> Tensor:
    dtype = np.dtype(dtype)
    if value.dtype == dtype:
        return value
    return graph.node("Cast", [value], value.shape, dtype, to=dtype.name)


def _convert(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    return _cast(graph, tensors[0], _out(equation)[1])


def _not_equal(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    equal = graph.node("Equal", _alike(graph, tensors), *_out(equation))
    return graph.node("Not", [equal], *_out(equation))


def _select(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    which, *cases = tensors
    if len(cases) != 2:
        raise ValueError("to_onnx: a selection among more than two values is not exported.")
    selected = _cast(graph, which, np.bool_)
    return graph.node("Where", _alike(graph, [selected, cases[1], cases[0]]), *_out(equation))


def _clamp(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    low, value, high = _alike(graph, tensors)
    shape, dtype = _out(equation)
    raised = graph.node("Max", [low, value], shape, dtype)
    return graph.node("Min", [raised, high], shape, dtype)


def _integer_pow(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    shape, dtype = _out(equation)
    power = equation.params["y"]
    if power == 2:
        return graph.node("Mul", [tensors[0], tensors[0]], shape, dtype)
    return graph.node("Pow", [tensors[0], graph.constant(np.asarray(power, dtype))], shape, dtype)


def _square(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    return graph.node("Mul", [tensors[0], tensors[0]], *_out(equation))


def _log1p(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    # log(1 + x) x / ((1 + x) - 1), which keeps all digits (Goldberg 1991, theorem 4).
    (x,), (shape, dtype) = tensors, _out(equation)
    one = graph.constant(np.ones((), dtype))
    more = graph.node("Add", [one, x], shape, dtype)
    selected = graph.node("Sub", [more, one], shape, dtype)
    none = graph.node("Equal", [selected, graph.constant(np.zeros((), dtype))], shape, np.bool_)
    under = graph.node("Where", [none, one, selected], shape, dtype)
    log = graph.node("Log", [more], shape, dtype)
    scaled = graph.node("Mul", [log, graph.node("Div", [x, under], shape, dtype)], shape, dtype)
    return graph.node("Where", [none, x, scaled], shape, dtype)


def _expm1(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    # 2 t / (1 - t) with t = tanh(x / 2), which keeps all digits near 0; exp(x) - 1 elsewhere.
    (x,), (shape, dtype) = tensors, _out(equation)
    half, one, two = (graph.constant(np.asarray(item, dtype)) for item in (0.5, 1.0, 2.0))
    t = graph.node("Tanh", [graph.node("Mul", [x, half], shape, dtype)], shape, dtype)
    near = graph.node("Less", [graph.node("Abs", [x], shape, dtype), one], shape, np.bool_)
    rest = graph.node(
        "Sub", [one, graph.node("Where", [near, t, half], shape, dtype)], shape, dtype
    )
    inner = graph.node("Div", [graph.node("Mul", [two, t], shape, dtype), rest], shape, dtype)
    outer = graph.node("Sub", [graph.node("Exp", [x], shape, dtype), one], shape, dtype)
    return graph.node("Where", [near, inner, outer], shape, dtype)


def _rsqrt(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    shape, dtype = _out(equation)
    root = graph.node("Sqrt", tensors, shape, dtype)
    return graph.node("Reciprocal", [root], shape, dtype)


def _round(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    return graph.node("Round", tensors, *_out(equation))  # a half to the even number, as in JAX


def _is_finite(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    shape, _ = _out(equation)
    maximum = graph.constant(np.finfo(tensors[0].dtype).max)
    size = graph.node("Abs", tensors, shape, tensors[0].dtype)
    return graph.node("LessOrEqual", [size, maximum], shape, np.bool_)


def _reduce(kind: str) -> Callable:
    def rule(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
        (x,) = tensors
        axes = graph.integers([axis + x.batched for axis in equation.params["axes"]])
        # ReduceMax and ReduceMin take their axes as a setting until version 18 of the operators.
        return graph.node(kind, [x, axes], *_out(equation), keepdims=0)

    return rule


def _argmax(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    (x,), (axis,) = tensors, equation.params["axes"]
    shape, dtype = _out(equation)
    node = graph.node("ArgMax", [x], shape, np.int64, axis=axis + x.batched, keepdims=0)
    return _cast(graph, node, dtype)


def _reshape(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    return graph.reshaped(tensors[0], _out(equation)[0])


def _broadcast(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    (x, *_), (shape, dtype) = tensors, _out(equation)
    position = dict(zip(equation.params["broadcast_dimensions"], x.shape))
    lined = graph.reshaped(x, [position.get(axis, 1) for axis in range(len(shape))])
    if lined.shape == shape:
        return lined
    target = graph.integers([1, *shape] if x.batched else shape)
    return graph.node("Expand", [lined, target], shape, dtype)


def _concatenate(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    batched = any(item.batched for item in tensors)
    parts = [graph.by_state(entry) for entry in tensors] if batched else tensors
    axis = equation.params["dimension"] + batched
    return graph.node("Concat", parts, *_out(equation), axis=axis)


def _stack(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    (axis,) = {equation.params[key] for key in ("axis", "dimension") if key in equation.params}
    batched = any(item.batched for item in tensors)
    parts = [
        graph.reshaped(entry, (*entry.shape[:axis], 1, *entry.shape[axis:]))
        for entry in (map(graph.by_state, tensors) if batched else tensors)
    ]
    return graph.node("Concat", parts, *_out(equation), axis=axis + batched)


def _slice(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    (x,), settings = tensors, equation.params
    starts, endpoints = settings["start_indices"], settings["limit_indices"]
    strides = settings["strides"] or (1,) * len(starts)
    axes = [i + x.batched for i in range(len(starts))]
    tensors = [x, *map(graph.integers, (starts, endpoints, axes, strides))]
    return graph.node("Slice", tensors, *_out(equation))


def unstacked(graph: Graph, equation: Any, tensors: list[Tensor]) -> list[Tensor]:
    """The entries along an axis, each as a separate array."""
    (x,), axis = tensors, equation.params["axis"]
    shape, dtype = _out(equation)
    parts = []
    for i in range(len(equation.outvars)):
        where = [x, *map(graph.integers, ((i,), (i + 1,), (axis + x.batched,), (1,)))]
        part = graph.node("Slice", where, (*shape[:axis], 1, *shape[axis:]), dtype)
        parts.append(graph.reshaped(part, shape))
    return parts


def _transpose(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    (x,) = tensors
    moved = [axis + x.batched for axis in equation.params["permutation"]]
    return graph.node("Transpose", [x], *_out(equation), perm=[0, *moved] if x.batched else moved)


def _iota(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    shape, dtype = _out(equation)
    axis = equation.params["dimension"]
    counted = np.arange(shape[axis], dtype=dtype)
    lined = counted.reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return graph.constant(np.broadcast_to(lined, shape).copy())


def _dot(graph: Graph, equation: Any, tensors: list[Tensor]) -> Tensor:
    (left, right), (shape, dtype) = tensors, _out(equation)
    (one, two), batch = equation.params["dimension_numbers"]
    if any(batch) or len(one) != 1 or max(len(left.shape), len(right.shape)) > 2:
        raise ValueError("to_onnx: a product of arrays of more than two axes is not exported.")
    left, right = (_cast(graph, item, dtype) for item in (left, right))
    rows = _matrix(graph, left, one[0], last=True)
    columns = _matrix(graph, right, two[0], last=False)
    if left.batched != right.batched:  # the other one's axis of states
        rows, columns = (
            entry
            if entry.batched
            else graph.reshaped(entry, (1, *entry.shape))._replace(batched=False)
            for entry in (rows, columns)
        )
    product = graph.node("MatMul", [rows, columns], (), dtype)
    return graph.reshaped(product, shape)


def _matrix(graph: Graph, value: Tensor, axis: int, last: bool) -> Tensor:
    """[rows, shared], or [shared, columns], of a vector or a matrix that is summed along `axis`."""
    if len(value.shape) == 1:
        return graph.reshaped(value, (1, *value.shape) if last else (*value.shape, 1))
    if (axis == 1) == last:
        return value
    moved = [0, 2, 1] if value.batched else [1, 0]
    return graph.node("Transpose", [value], value.shape[::-1], value.dtype, perm=moved)


def unrolled(graph: Graph, settings: Any, tensors: list[Tensor], write: Callable) -> list[Tensor]:
    """A loop with a small, fixed number of rounds that returns only the values that it carries."""
    count, carried = arguments_of_scan(settings)
    if settings["length"] > MAXIMUM or len(tensors) != count + carried:
        raise ValueError(f"to_onnx: a loop of more than {MAXIMUM} rounds is not exported.")
    fixed, moving = tensors[:count], tensors[count:]
    for _ in range(settings["length"]):
        moving = write(graph, settings["jaxpr"].jaxpr, settings["jaxpr"].consts, [*fixed, *moving])
    return moving


RULES: dict[str, Callable] = {
    **{name: _same(kind) for name, kind in SAME.items()},
    **{name: _reduce(kind) for name, kind in REDUCED.items()},
    "convert_element_type": _convert, "ne": _not_equal, "select_n": _select, "clamp": _clamp,
    "integer_pow": _integer_pow, "square": _square, "log1p": _log1p, "expm1": _expm1,
    "rsqrt": _rsqrt, "round": _round, "is_finite": _is_finite, "argmax": _argmax,
    "reshape": _reshape, "squeeze": _reshape, "expand_dims": _reshape,
    "broadcast_in_dim": _broadcast, "concatenate": _concatenate, "stack": _stack,
    "slice": _slice,
    "transpose": _transpose, "iota": _iota, "dot_general": _dot,
}  # fmt: skip
