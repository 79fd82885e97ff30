"""The cells over size in which crystals are counted, as a case defines them."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from snapo.case.table import CaseTable, doc

from ...read.declared import LENGTH
from ...read.numbers import NOT_NEGATIVE
from ...read.reader import Reader, whole
from .seed import Seed

SEED_OUTSIDE = 0.01  # most of a seed's volume that may lie outside a grid


SIZE = replace(LENGTH, form="number")


class SizesTable(CaseTable):
    """`[units.NAME.sizes]`"""

    smallest: float = SIZE.field("smallest size of a crystal", range=NOT_NEGATIVE, example="0 um")
    largest: float = SIZE.field("largest size of a crystal", example="400 um")
    cells: int = whole("number of cells over size", 4, 1000)
    spacing: Literal["equal", "geometric"] = doc(
        "widths of the cells, equal or in proportion to size", "equal"
    )


def read_edges(read: Reader) -> np.ndarray:
    """[N + 1] m, the edges of the cells."""
    low, high = read.table.smallest, read.table.largest
    if high <= low:
        raise read.section.error("largest", read.raw["largest"], "it must be above `smallest`")
    if read.table.spacing == "equal":
        return np.linspace(low, high, read.table.cells + 1)
    if low == 0:
        message = 'spacing "geometric" needs a smallest size above 0'
        raise read.section.error("smallest", read.raw["smallest"], message)
    return np.geomspace(low, high, read.table.cells + 1)


def halved(edges: np.ndarray) -> np.ndarray:
    """The edges of twice as many cells, spaced in the same way."""
    low, high = edges[:-1], edges[1:]
    equal = np.allclose(np.diff(edges), edges[1] - edges[0], rtol=1e-6)
    return np.sort(np.append(edges, (low + high) / 2 if equal else np.sqrt(low * high)))


def check_seed(read: Reader, edges: np.ndarray, seed: Seed) -> None:
    """Refuses a grid that does not contain all of the seed."""
    outside = _volume_outside(seed, float(edges[0]), float(edges[-1]))
    if outside > SEED_OUTSIDE:
        message = f"{100 * outside:.3g} % of the seed's volume lies outside `smallest` to `largest`"
        raise read.section.error("largest", read.raw["largest"], message)


def _volume_outside(seed: Seed, low: float, high: float) -> float:
    """Share of a lognormal seed's volume in crystals below `low` or above `high` m."""
    assert seed.size is not None and seed.spread is not None
    variance = math.log1p(float(seed.spread.values[0]) ** 2)
    # By volume the distribution of the logarithm lies three variances higher than by number.
    centre = math.log(float(seed.size.values[0])) + 2.5 * variance
    z = [(math.log(max(item, 1e-12)) - centre) / math.sqrt(2 * variance) for item in (low, high)]
    return (math.erfc(z[1]) + math.erfc(-z[0])) / 2
