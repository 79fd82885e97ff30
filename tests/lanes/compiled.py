"""A function of arrays, compiled for one block of paths by `snapo.lanes` alone."""

import ctypes

import jax
import numpy as np

from snapo.lanes import body
from snapo.lanes.emit.code import Code
from snapo.lanes.emit.module import Module
from snapo.lanes.emit.storage import Layout
from snapo.lanes.emit.values import EmittedValues, Workspace
from snapo.lanes.machine.linked import KernelMemory, Linked
from snapo.lanes.machine.pipeline import host, object_code
from snapo.lanes.program.flatten import flatten
from snapo.lanes.program.passes import optimize


def text(function, shapes, dtype: str = "float32"):
    """The module's text, the layouts of its inputs and outputs, and its scratch memory."""
    lanes = host().lanes(dtype)
    closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(s, dtype) for s in shapes))
    program = optimize(flatten(closed, [True] * len(shapes)))
    given, found = Layout(lanes), Layout(lanes)
    for value in program.inputs:
        given.add(value, value.shape, value.dtype)
    for i, value in enumerate(program.outputs):
        found.add(i, value.shape, value.dtype)
    module = Module(lanes, host().register)
    code = Code(lanes, module)
    values = EmittedValues(code, Workspace("%work"))
    for value in program.inputs:
        values.bind(value, given.address(value, "%given"))
    body.write(values, program.ops, program.outputs)
    for i, value in enumerate(program.outputs):
        values.copy(value, found.address(i, "%found"))
    code.do("ret void")
    code.define("define void @run(ptr %given, ptr %found, ptr %work) nounwind")
    return module.text(), given, found, values.workspace.size


def run(function, *arrays: np.ndarray) -> list[np.ndarray]:
    """The function of every path: arrays [lanes, ...], results [lanes, ...]."""
    dtype = arrays[0].dtype.name
    written, given, found, work = text(function, [a.shape[1:] for a in arrays], dtype)
    machine = Linked(object_code(written), {"run": 0})
    memory = KernelMemory({"given": given.stride, "found": found.stride, "work": work})
    for key, array in zip(given.fields, arrays):
        given.view(memory["given"], key)[...] = np.moveaxis(array, 0, -1)
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)
    kind(machine.addresses["run"])(*(memory.where[name] for name in ("given", "found", "work")))
    results = [found.view(memory["found"], key) for key in found.fields]
    return [np.moveaxis(result, -1, 0).copy() for result in results]
