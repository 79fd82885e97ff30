"""Reads `[rates]` and `[inflation]`: the models of the short rate, prices and wages."""

from snapo.case.given import Given
from snapo.case.table import nearest

from ..market.rates.registry import MODELS
from ..market.rates.short_rate import ShortRate
from ..records.market import Inflation
from ..records.said import SQUARE_ROOT, YEARLY, Said, number, quiet_volatility, rate
from .cells import Grid, Place, alone, single, stepwise
from .curve import Quotes, quotes
from .tables import InflationTable, RatesTable

# Ready-made scenarios need no model: this one stands still.
IDLE = "hull-white"
BREAK_EVEN = rate("IE01: the break-even at one node, while nominal rates are held", "curve")
EXPECTED = "of expected inflation; break-evens are fitted again"
SAID = {
    "mean_reversion": number(f"mean reversion {EXPECTED}", "model", YEARLY),
    "volatility": quiet_volatility(f"volatility {EXPECTED}"),
    "price_of_risk": number(f"price of the risk {EXPECTED}", "premium", SQUARE_ROOT),
    "index_volatility": quiet_volatility("volatility of realised prices"),
    "index_price_of_risk": number("price of the risk of realised prices", "premium", SQUARE_ROOT),
    "real_wage_growth": rate("growth of wages over prices", "model"),
    "wage_volatility": quiet_volatility("volatility of wages over prices"),
}


def read_rates(section: Place, table: RatesTable | None, grid: Grid) -> ShortRate:
    """The model with its numbers; without the table, one at rest."""
    if table is None:
        return MODELS[IDLE].at_rest(grid.steps)
    if table.kind not in MODELS:
        known = ", ".join(f'"{each}"' for each in sorted(MODELS))
        what = f"allowed is one of {known}; {nearest(table.kind, sorted(MODELS))}"
        raise section.error("kind", table.kind, what)
    return MODELS[table.kind].read(section, table, grid)


def read_inflation(section: Place, table: InflationTable, grid: Grid) -> Inflation:
    """Break-evens under "break_even", and the models of prices and wages."""

    def one(name: str, key: str, said: Said) -> Given:
        return section.told(table, key, single(name, getattr(table, key), said))

    def moving(name: str, key: str) -> Given:
        part = stepwise(section, key, getattr(table, key), grid)
        return section.told(table, key, alone(name, part, SAID[key]))

    columns = {"rate": ("break_even", BREAK_EVEN), "forward": ("break_even", BREAK_EVEN)}
    given = Quotes("break_evens", table.break_evens, columns, "ultimate_break_even")
    return Inflation(
        break_even=quotes(section, table, given),
        mean_reversion=one("inflation_mean_reversion", "mean_reversion", SAID["mean_reversion"]),
        volatility=moving("inflation_volatility", "volatility"),
        price_of_risk=one("inflation_price_of_risk", "price_of_risk", SAID["price_of_risk"]),
        index_volatility=moving("index_volatility", "index_volatility"),
        **{
            key: one(key, key, SAID[key])
            for key in ("index_price_of_risk", "real_wage_growth", "wage_volatility")
        },
    )
