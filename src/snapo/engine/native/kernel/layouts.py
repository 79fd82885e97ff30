"""Rows of memory: tables of one lane for all that paths share, and blocks of lanes for the rest."""

import numpy as np

from snapo.lanes.emit.storage import Layout

from ..rollout import Traced

Layouts = dict[str, Layout]

SHARED = ("table", "steps", "call_sums", "step_sums")
TAPES = {"initial": "tape_initial", "step": "tape", "final": "tape_final"}  # by phase
BLOCKS = (
    "carry", "cotangent", "start", "start_cotangent", "final", "weights", "records", "bounds",
    "actions", *TAPES.values(),
)  # fmt: skip


def layouts(t: Traced, lanes: int) -> Layouts:
    """The rows of one kernel by name; those of the tapes are filled when a sweep is written."""
    rows = {name: Layout(1) for name in SHARED} | {name: Layout(lanes) for name in BLOCKS}
    _shared(rows, t)
    _state(rows, t)
    _totals(rows, t)
    step = t.phases["step"]
    for key, aval in step.outputs:
        if key[0] == "record":
            rows["records"].add(key, aval.shape, aval.dtype)
    for key, aval in step.inputs:
        if key == "action":
            rows["actions"].add(key, aval.shape, aval.dtype)
    return rows


def _shared(rows: Layouts, t: Traced) -> None:
    """Tables of the call and of its steps, and in float64 the sums of gradients by them."""
    calls = [*t.call, *(leaf for p in t.phases.values() for leaf in p.cut.call_leaves)]
    nows = [*t.now, *t.phases["step"].cut.step_leaves]
    for leaf in dict.fromkeys(calls):
        rows["table"].add(leaf, leaf.shape, leaf.dtype)
        if leaf.active:
            rows["call_sums"].add(leaf, leaf.shape, np.float64)
    for leaf in dict.fromkeys(nows):
        rows["steps"].add(leaf, leaf.shape, leaf.dtype)
        if leaf.active:
            rows["step_sums"].add(leaf, leaf.shape, np.float64)


def _state(rows: Layouts, t: Traced) -> None:
    """A path's state: as it goes on, as it is given, as it is left; and the adjoints of both."""
    for i, x in enumerate(t.state):
        for name, key in (("carry", "state"), ("start", "start"), ("final", "end")):
            rows[name].add((key, i), x.shape, x.dtype)
        if x.dtype == t.setup.dtype:
            rows["cotangent"].add(("state", i), x.shape, x.dtype)
            rows["start_cotangent"].add(("start", i), x.shape, x.dtype)


def _totals(rows: Layouts, t: Traced) -> None:
    """A path's totals, their weights, and the bound of its adjoint with the share it keeps."""
    real = np.dtype(t.setup.dtype)
    for n in t.names:
        rows["carry"].add(("total", n), (), real)
        rows["cotangent"].add(("total", n), (), real)
    for n in t.final_names:
        rows["final"].add(("final", n), (), real)
        rows["weights"].add(("final", n), (), real)
    rows["bounds"].add("bound", (2,), real)
