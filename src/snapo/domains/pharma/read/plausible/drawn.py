"""Distributions that draw impossible values: the share of such draws, noted or refused."""

import math
from typing import Any

from scipy.special import ndtr

from snapo.case.table import TableContext

from ...given import Entry
from ...quality.records import Distribution
from ..entries import EntryNumbers, limits

REFUSED, NOTED = 1e-3, 1e-7  # of the draws


def check_drawn(
    section: TableContext, raw: Any, distribution: Distribution, numbers: EntryNumbers, entry: Entry
) -> None:
    """Refuses a distribution of which one draw in a thousand is impossible; notes rarer ones."""
    values = numbers.givens[entry[0]]
    share = outside(distribution, numbers.value(entry), values.low, values.high)
    if share <= NOTED:
        return
    metadata = f"{100 * share:.2g} % of its draws are none that {numbers.name_of(entry)} can have"
    metadata += f" ({limits(values)})"
    if share > REFUSED:
        hint = "" if values.low < 0 else '; kind "lognormal" stays above 0'
        raise section.error("distribution", raw, f"{metadata}{hint}")
    section.notes.append(f"{section.name}: {metadata}.")


def outside(distribution: Distribution, centre: float, low: float, high: float) -> float:
    """The share of draws below `low` or above `high`; formulas in `Distribution`."""
    spread = distribution.spread

    def below(x: float) -> float:
        if math.isinf(x):
            return 0.0 if x < 0 else 1.0
        match distribution.kind:
            case "normal":
                return float(ndtr((x - centre) / spread))
            case "uniform":
                return min(1.0, max(0.0, ((x - centre) / spread + 1) / 2))
            case "lognormal":
                if x <= 0 or x < 1e-300:
                    return 0.0
                return float(ndtr((math.log(x / centre) + spread**2 / 2) / spread))

    return below(low) + 1 - below(high)
