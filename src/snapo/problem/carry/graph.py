"""An ONNX graph while it is built. Every tensor is one of a batch: its first axis counts states."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np


class Tensor(NamedTuple):
    """A value in the graph: its name, the shape and type of ONE state, and whether it differs by
    state. One that does not has no axis of states; it is broadcast against those that do."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype
    batched: bool


class Graph:
    """Nodes and constants of a graph with one input, the observations [states, features]."""

    def __init__(self, features: int, dtype: Any):
        self.nodes: list[Any] = []
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
        """The output of one operation; it differs by state where any of its inputs does."""
        from onnx import helper

        name = f"v{len(self.nodes)}"
        names = [item.name for item in inputs]
        self.nodes.append(helper.make_node(kind, names, [name], **settings))
        batched = any(entry.batched for entry in inputs)
        return Tensor(name, tuple(shape), np.dtype(dtype), batched)

    def integers(self, numbers: Sequence[int]) -> Tensor:
        """A constant of 64-bit integers, as shapes and axes are given."""
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

    def model(self, result: Tensor, about: str) -> Any:
        """The whole, as an ONNX model that its own checker has passed."""
        import onnx
        from onnx import TensorProto, helper, numpy_helper

        kinds = {np.dtype(np.float32): TensorProto.FLOAT, np.dtype(np.float64): TensorProto.DOUBLE}
        result = self.node("Identity", [self.by_state(result)], result.shape, result.dtype)
        self.nodes[-1].output[0] = "action"
        values, results = (
            helper.make_tensor_value_info(name, kinds[item.dtype], ["states", *item.shape])
            for name, item in (("observation", self.input), ("action", result))
        )
        used = {name for node in self.nodes for name in node.input}
        tables = [
            numpy_helper.from_array(constant, name)
            for name, constant in self.constants.items()
            if name in used
        ]
        graph = helper.make_graph(self.nodes, "policy", [values], [results], tables, about)
        # Of 2022 and 2023: runtimes of that age read the file.
        operators = [helper.make_opsetid("", 18)]
        model = helper.make_model(graph, producer_name="snapo", opset_imports=operators)
        model.ir_version = 8
        onnx.checker.check_model(model, full_check=True)
        return model
