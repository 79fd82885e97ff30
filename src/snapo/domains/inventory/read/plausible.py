"""Ranges outside which a number of an inventory is likely to be in another unit; all are notes."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from snapo.case.plausible import CaseFiles, CheckedNumbers, Plausible, checked_numbers, implausible

from ..demand.base import DEVIATION, MEAN


def unit_slips(files: CaseFiles, inputs: Iterable[Any], period: str) -> list[str]:
    """Notes on the numbers of an item, or of a network."""
    entries = [checked_numbers(entry) for entry in inputs]
    return list(implausible(entries, list(_ranges(entries, period)), files).values())


def _ranges(entries: Sequence[CheckedNumbers], period: str) -> Iterator[Plausible]:
    """The ranges, some of them by the size of other numbers of the case."""
    by_period = f"it is of one {period}"
    yield Plausible(0.5, 1.0, f"a factor by {period} is meant, 0.999 and not the rate 0.001",
                    names=("discount",))  # fmt: skip
    cost = {entry.name: entry.values[entry.values > 0] for entry in entries}
    short, bought = (cost.get(name, np.zeros(0)) for name in ("shortage_cost", "purchase_cost"))
    if short.size:
        hint = f"{by_period} and unit, and a unit short costs {short.max():.6g}"
        yield Plausible(short.max() / 1e5, 10 * short.max(), hint, names=("holding_cost",))
    if bought.size:
        hint = f"a unit costs {bought.max():.6g}"
        yield Plausible(bought.max() / 1e3, 1e3 * bought.max(), hint, names=("shortage_cost",))
    mean = max(
        (float(entry.values.max()) for entry in entries if entry.name.endswith(MEAN)), default=0.0
    )
    if mean > 0:
        hint = f"{by_period}, and the mean demand is {mean:.6g}"
        yield Plausible(0.0, 5 * mean, hint, endings=(DEVIATION,))
        hint = f"the mean demand of a {period} is {mean:.6g}"
        yield Plausible(0.0, 1000 * mean, hint, names=("start_stock", "start_coming"))
