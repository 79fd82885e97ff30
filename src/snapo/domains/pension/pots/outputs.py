"""The outputs of a path of a fund of pots, in addition to those of every fund."""

from ..records.people import FundMembers

# At the horizon: the mean pension over that of today, weighted by the pots of today, and the
# reserve's share of the assets. Sums over steps: money into the reserve at the ends of years, and
# out of it.
POT_OUTPUTS = ("pension", "reserve", "filled", "released")


def pensions(members: FundMembers | None) -> tuple[str, ...]:
    """The output of each cohort: its pension at the horizon over that of today."""
    return () if members is None else tuple(f"pension {name}" for name in members.names)
