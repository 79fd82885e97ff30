"""`[hedge]`: the hedges that `snapo solve --hedge` simulates.

[hedge]
deltas = [["months"], ["months", "balance_of_month", "day_ahead"]]
least_variance = [["months", "day_ahead"]]
paths = 8192
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from snapo.case.table import CaseTable, Range, TableContext, doc, parse

from ..ladder.products import FAMILIES, TradedProducts
from . import DELTAS, MIN_VARIANCE, DailyHedge, usual_hedges

PATHS = 8192
SETS = 'a list of lists of the keys of [products], like [["months"], ["months", "day_ahead"]]'


class HedgeTable(CaseTable):
    """`[hedge]`: sets of products; each set is a hedge."""

    deltas: list[list[str]] | None = doc(
        "sets of products, each of which hedges its own exposure", None, SETS
    )
    least_variance: list[list[str]] | None = doc(
        "sets of products; the first of each family are traded to minimise the next day's variance",
        None,
        SETS,
    )
    paths: Annotated[int, Range(256, 1 << 20)] = doc(
        "number of simulated paths; the exposures are fitted on twice this number", PATHS
    )


class Hedges(NamedTuple):
    """The daily hedges of a case on `paths` paths."""

    daily: tuple[DailyHedge, ...]
    paths: int = PATHS


def hedges_of(
    file: Path, data: Any, notes: list[str], products: TradedProducts | None
) -> Hedges | None:
    """The hedges of the table [hedge], None for a case without one.

    **Raises:** `CaseError` if a set has a product that is not traded.
    """
    if data is None:
        return None
    section = TableContext(file, "hedge", notes)
    table = parse(HedgeTable, data, str(file), "hedge", notes)
    families = FAMILIES[:3] if products is None else products.families
    usual = usual_hedges(families)

    def sets(key: str, rule: str) -> list[DailyHedge]:
        entries = getattr(table, key)
        if entries is None:
            return [hedge for hedge in usual if hedge.rule == rule]
        return [_hedge(section, key, rule, entry, families) for entry in entries]

    daily = (*sets("deltas", DELTAS), *sets("least_variance", MIN_VARIANCE))
    return Hedges(daily, table.paths)


def _hedge(
    section: TableContext, key: str, rule: str, entry: list[str], families: Sequence[str]
) -> DailyHedge:
    for name in entry:
        if name not in families:
            allowed = ", ".join(f'"{x}"' for x in families)
            raise section.error(
                key, name, f"it may contain only the traded keys of [products]: {allowed}"
            )
    if not entry:
        raise section.error(key, entry, "a hedge must have at least one product")
    return DailyHedge(rule, tuple(x for x in families if x in entry))
