"""Auctions: the flows of a block of hours are fixed together, at forward prices."""

import datetime
from dataclasses import replace
from typing import Any, Literal
from zoneinfo import ZoneInfo

from snapo.case.table import CaseTable, TableContext, doc

from .hours import Hours

TIMES = tuple(f"{hour:02d}:00" for hour in range(24))
AUCTION = 'a table like { at = "00:00", step = "4h" }'


class AuctionTable(CaseTable):
    """{ at = "00:00", step = "4h" }: auctions at this hour of every day, and at every `step` after
    it, by the local clock. Each auction fixes the flows of the hours up to the next auction.
    """

    at: str = doc(
        "hour of the local clock at which there is an auction every day",
        "00:00",
        'a full hour of local time such as "00:00"',
    )
    step: Literal["1h", "2h", "3h", "4h", "6h", "8h", "12h", "24h"] = doc("time between auctions")


def at_auctions(where: TableContext, table: Any, hours: Hours) -> Hours:
    """The hours, each of which is decided at its auction; unchanged if `table`, the table
    `[contract]`, has no `auction`.

    **Raises:** `CaseError` if the times of the auctions are not allowed.
    """
    if table.auction is None:
        if table.intraday is not None:
            message = "it trades differences from the schedules of auctions; specify `auction` too"
            raise where.error("intraday", None, message)
        return hours
    auction = where.nested(AuctionTable, table.auction, "auction")
    if auction.at not in TIMES:
        message = 'it must be a full hour from "00:00" to "23:00"'
        raise where.error("auction.at", auction.at, message)
    if table.intraday is None:
        where.notes.append(
            "contract.auction: flows are fixed at the auctions. The paths have the prices and "
            "cash flows at the auctions, which vary less than those of the spot market."
        )
    zone, step = ZoneInfo(table.time_zone), int(auction.step[:-1])
    instants = (*hours.instants, hours.instants[-1] + datetime.timedelta(hours=1))
    notice = []
    for instant, ahead in zip(instants, hours.ahead):
        fixed = auction_of(instant, zone, TIMES.index(auction.at), step)
        before = int((instant - fixed).total_seconds()) // 3600
        notice.append(min(before, ahead))  # an auction before the valuation date is on it
    if table.intraday is not None and notice[0] and hours.ahead[0]:
        message = "with `intraday` it must be the hour of an auction, or the valuation date"
        raise where.error("start", hours.local[0], message)
    return replace(
        hours,
        ahead=tuple(x - y for x, y in zip(hours.ahead, notice)),
        notice=tuple(notice),
    )


def auction_of(instant: datetime.datetime, zone: ZoneInfo, at: int, step: int) -> datetime.datetime:
    """The last auction at or before the beginning of an hour, both in UTC.

    `at`: the hour of one of the auctions of each day; `step`: hours between auctions by the local
    clock. An hour with an auction that the clock shows twice has two auctions. An auction in an
    hour that the clock skips takes place in the next hour.
    """
    local = instant.astimezone(zone)
    back = datetime.timedelta(hours=(local.hour - at) % step)
    wall = local.replace(tzinfo=None, minute=0) - back
    moments = (wall.replace(tzinfo=zone, fold=k).astimezone(datetime.UTC) for k in (0, 1))
    return max(moment for moment in moments if moment <= instant)


def check_auction(where: TableContext, table: Any, objective: str) -> None:
    """Raises `CaseError` if the objective needs the spot prices of the hours."""
    if table.auction is not None and table.intraday is None and objective != "mean":
        message = (
            "the cash flow of an hour is counted at the forward price of its auction, so that "
            f'"{objective}" cannot be computed; the objective must be "mean"'
        )
        raise where.error("auction", None, message)
