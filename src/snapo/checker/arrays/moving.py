"""Indices that move with state, noise or inputs, where they leave their array on a path."""

import numpy as np

from ..findings import Notes
from ..program.points import SamplePoints
from ..program.watch import CodeSite
from .indices import CORRECT

MEANT = "jnp.clip(index, 0, length - 1) says that the nearest entry is meant."
FEW = 32  # points outside at which the entry that is read is looked at


def moving_indices(notes: Notes, points: SamplePoints) -> None:
    """Reads past an end that move a result, and writes past it, which JAX drops."""
    monitored, summary = points.recorder, set()
    if not monitored.reads:
        return
    sites = zip(monitored.reads, points.met.outside)
    for number, (site, (index, axis, is_outside)) in enumerate(sites):
        which = np.flatnonzero(is_outside)
        if not which.size or (site.line is not None and site.line.user_code):
            continue
        if not site.writes and not _matters(points, number, which):
            continue
        met, length, size = _met(site, index[which], axis[which])
        if (site.line, length) not in summary:
            summary.add((site.line, length))
            _write(notes, points.method.name, site, _said(met, length, size))


def _matters(points: SamplePoints, number: int, which: np.ndarray) -> bool:
    """Whether the entry that is read outside moves a result: `jnp.where` may leave it out."""
    which = which[np.unique(np.linspace(0, len(which) - 1, min(len(which), FEW)).astype(int))]
    arguments = points.some(which)
    here = points.recorder.nothing(len(which))._replace(read=np.int32(number))
    as_read, up, down = (
        points.observe(arguments, here._replace(shift=np.float64(shift))).results
        for shift in (0, 1, -1)
    )
    return any(
        not np.array_equal(x, y, equal_nan=x.dtype.kind == "f")
        for other in (up, down)
        for x, y in zip(as_read, other)
    )


def _met(site: CodeSite, index: np.ndarray, axis: np.ndarray) -> tuple[int, int, int]:
    """The index farthest outside, as it was written, the length and the size of the part."""
    ranges = np.array(site.ranges)[axis]
    k = int(np.argmax(np.where(index < 0, -index, index - ranges[:, 0] + ranges[:, 1])))
    length, size = (int(n) for n in ranges[k])
    # A negative one was written before JAX added the length to it.
    return int(index[k]) - length * int(index[k] < 0), length, size


def _said(met: int, length: int, size: int) -> str:
    if size > 1:
        return f"{size} entries are taken from index {met} on and the array has {length}"
    return f"an index is {met} and the array has {length} entries"


def _write(notes: Notes, method: str, site: CodeSite, metadata: str) -> None:
    where = f"{method}, {site.line}" if site.line else notes.method(method)
    text = f" In: {site.line.text}" if site.line else ""
    met = "With these inputs" if method == "prepare" else "On a path"
    done = "drops such a write" if site.writes else "reads the nearest one"
    note = notes.warning if site.writes else notes.error
    note(
        where,
        f"{met} {metadata}: JAX {done}, without an error.{text}",
        CORRECT if site.writes else f"{CORRECT} {MEANT}",
    )
