"""Kernels on disk, with the results of tracing and writing them: a process that needs a kernel of
an earlier process neither traces nor writes it again.

A file is named by all that a trace reads (`problem.code.described`), so that it is used for the
same sources, settings and processor only. A simulator or policy with user code is traced in every
process, since no text describes all that this code reads.
"""

import json
import zlib
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.lanes.emit.storage import Layout
from snapo.lanes.machine import disk
from snapo.lanes.machine.code_cache import KERNELS, code_folder
from snapo.lanes.machine.pipeline import host
from snapo.lanes.program.cut import Leaf
from snapo.problem.code import described

from .kernel.kernel import Kernel
from .rollout import FunctionSetup, KernelTrees, SharedTree, initial_state, parted

ENDING = ".kernel"


class StoredKernel:
    """The file in which a kernel is stored. Its name is computed from the arguments with which the
    kernel is traced.

    **Arguments:**

    - `simulator`: its class is part of the name.
    - `shared`, `steps`: trees that paths share, as in `NativeCall`.
    - `like`: shapes of a supplied starting state, or None.
    - `noise`: how many numbers the initial noise of a path has.
    """

    def __init__(
        self, simulator: Any, shared: SharedTree, steps: SharedTree, like: Any,
        setup: FunctionSetup, noise: int,
    ):  # fmt: skip
        self.shared, self.steps, self.like = shared, steps, like
        self.setup, self.noise = setup, noise
        trees = type(simulator), shared.shapes(), steps.shapes(1), like, (setup, tuple(host()))
        self.text = described.described(*trees)

    @cached_property
    def path(self) -> Path | None:
        """The file; None for a kernel that no text describes."""
        if self.text is None:
            return None
        name = sha256(f"{described.settings()}\n{self.text}".encode()).hexdigest()
        return code_folder(KERNELS) / f"{name}{ENDING}"

    def read(self) -> Kernel | None:
        """The kernel; None if none is stored."""
        data = None if self.path is None else disk.read(self.path)
        if data is None:
            return None
        head, text = zlib.decompress(data).decode().split("\n", 1)
        content = json.loads(head)
        trees = self._trees(content["trees"])
        layouts = {name: _layout(row, trees) for name, row in content["layouts"].items()}
        return Kernel(text, content["lanes"], trees, layouts, content["sizes"])

    def write(self, kernel: Kernel) -> None:
        """Stores a kernel that was made for these arguments."""
        names = _record_names(kernel.trees)
        if self.path is None or names is None:
            return
        trees = kernel.trees
        content = {
            "lanes": kernel.lanes,
            "sizes": kernel.sizes,
            "layouts": {name: _row(item, trees) for name, item in kernel.layouts.items()},
            "trees": {
                "call": [leaf.active for leaf in trees.call],
                "now": [leaf.active for leaf in trees.now],
                "requested": trees.requested,
                "state": [(x.shape, str(x.dtype)) for x in trees.state],
                "names": trees.names,
                "final_names": trees.final_names,
                "records": names,
            },
        }
        text = f"{json.dumps(content)}\n{kernel.text}"
        disk.write(self.path, zlib.compress(text.encode(), 1))

    def _trees(self, content: dict[str, Any]) -> KernelTrees:
        segments, call = parted(self.shared.split())
        _, now = parted(self.steps.split(), skip=1)
        state = [jax.ShapeDtypeStruct(tuple(shape), dtype) for shape, dtype in content["state"]]
        like = self.like
        if like is None:
            noise = jax.ShapeDtypeStruct((self.noise,), np.dtype(self.setup.dtype))
            like = initial_state(segments, call, noise)
        tree = jax.tree.structure(like)
        return KernelTrees(
            self.setup, _leaves(call, content["call"]), _leaves(now, content["now"]),
            content["requested"], state, tree, content["names"], content["final_names"],
            _record_tree(self.setup.record, tree, content["records"]),
        )  # fmt: skip


def _leaves(shapes: list, active: list[bool]) -> list[Leaf]:
    return [Leaf(x.shape, x.dtype, item) for x, item in zip(shapes, active, strict=True)]


def _record_names(trees: KernelTrees) -> dict[str, list[str]] | None:
    """The names in records that have some; None if a record has another structure."""
    tree = trees.record_tree
    record = jax.tree.unflatten(tree, range(tree.num_leaves))
    names = {name: list(part) for name, part in record.items() if isinstance(part, dict)}
    same = _record_tree(trees.setup.record, trees.state_tree, names) == tree
    return names if same else None


def _record_tree(record: tuple[str, ...], state: Any, names: dict[str, list[str]]) -> Any:
    """The structure of a kernel's records."""
    parts: dict[str, Any] = {"state": jax.tree.unflatten(state, range(state.num_leaves))}
    parts |= {name: dict.fromkeys(items, 0) for name, items in names.items()}
    return jax.tree.structure({name: parts.get(name, 0) for name in record})


def _row(layout: Layout, trees: KernelTrees) -> dict[str, Any]:
    """A layout as JSON, with the fields that calls fill and read."""
    names: dict[object, Any] = {k: k for k in layout.fields if isinstance(k, str | tuple)}
    names |= {leaf: ("call", i) for i, leaf in enumerate(trees.call)}
    names |= {leaf: ("now", i) for i, leaf in enumerate(trees.now)}
    fields = [
        (names[key], offset, shape, str(dtype))
        for key, (offset, shape, dtype) in layout.fields.items()
        if key in names
    ]
    return {"lanes": layout.lanes, "size": layout.size, "fields": fields}


def _layout(row: dict[str, Any], trees: KernelTrees) -> Layout:
    layout = Layout(row["lanes"])
    layout.size = row["size"]
    for key, offset, shape, dtype in row["fields"]:
        layout.fields[_key(key, trees)] = offset, tuple(shape), np.dtype(dtype)
    return layout


def _key(key: Any, trees: KernelTrees) -> object:
    if isinstance(key, str):
        return key
    kind, item = key
    leaves = {"call": trees.call, "now": trees.now}
    return leaves[kind][item] if kind in leaves else (kind, item)
