"""The numbers of a problem that all paths share, and the state of one path."""

from typing import Any, NamedTuple

from snapo.problem.record.arrays import Array, Float, PyTree

from .contract import StepTerms
from .feasibility import Intervals


class Step(NamedTuple):
    """One step, the same for all paths; leaves have a leading axis T in the schedule.

    - `time`: years from the valuation date; `forward`: the forward price of the commodity.
    - `price`: the row of the price process; `ahead`: the shape of the curve.
    - `unit_values`, `surprise`: tables of the fitted value, if there is one.
    - `auction`, `begins`, `scheduled_values`: the row of the price process of the auctions, whether
      an auction is at this step, and the fitted value of a contract whose flows never differ from
      the schedule. None if no schedules are fixed at auctions with trades of the differences.
    """

    time: Array
    forward: Array
    terms: StepTerms
    intervals: Intervals
    price: PyTree
    ahead: Array
    unit_values: Any = None
    surprise: Any = None
    auction: PyTree = None
    begins: Array | None = None
    scheduled_values: Any = None


class Constants(NamedTuple):
    """`start`: the initial levels; `price`, `auction`: the constants of the price processes; and
    the scales of the features."""

    start: Float[Array, " levels"]
    price: PyTree
    price_scale: Array
    volume_scale: Array
    last_time: Array
    first_value: Any = None
    auction: PyTree = None


class State(NamedTuple):
    """The levels at the start of a step, the weight of each mode (1 for the present mode, otherwise
    0), and the prices.

    If flows are scheduled at auctions, `scheduled` are the scheduled levels at the start of the
    step, and `auction_price` is the state of the prices at the last auction.
    """

    levels: Float[Array, " levels"]
    mode: Float[Array, " modes"]
    price: PyTree
    scheduled: Any = None
    auction_price: PyTree = None
