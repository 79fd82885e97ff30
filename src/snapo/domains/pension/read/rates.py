"""Reads `[rates]`: the model of the short rate, found by its word."""

from snapo.case.table import nearest

from ..market.rates.registry import MODELS
from ..market.rates.short_rate import ShortRate
from .cells import Grid, Place
from .tables import RatesTable

# Ready-made scenarios need no model: this one stands still.
IDLE = "hull-white"


def read_rates(section: Place, table: RatesTable | None, grid: Grid) -> ShortRate:
    """The model with its numbers; without the table, one at rest."""
    if table is None:
        return MODELS[IDLE].at_rest(grid.steps)
    if table.kind not in MODELS:
        known = ", ".join(f'"{each}"' for each in sorted(MODELS))
        what = f"allowed is one of {known}; {nearest(table.kind, sorted(MODELS))}"
        raise section.error("kind", table.kind, what)
    return MODELS[table.kind].read(section, table, grid)
