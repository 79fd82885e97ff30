"""The balance sheet today and after the policy's first decision: trades, key rates, collateral."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from snapo.problem.inputs import plain
from snapo.report.bands import Bars, Layer, grouped, stack
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Facts, Table, Text
from snapo.report.quantity import number
from snapo.study.chapter import Chapter
from snapo.study.study import StudyRun

from ..policies.allocation import limit_unit, notionals
from ..records.case import PensionCase
from ..results import balance
from ..results.balance import CurveLadder, Headroom, TradeList
from ..results.figures.reconcile import figures
from ..results.setup import case_of
from ..run import PensionRun, points, share, with_measure
from .paths import PATHS, LimitBreaches, PathTables

BREACHES = (("collateral", "Collateral falls short"), ("weights", "Weights leave their bounds"))
EDGES = (3.5, 7.5, 12.5, 17.5, 25.0, 35.0, 45.0)  # years: half-way between the tenors named
BUCKET_NAMES = ("to 3y", "5y", "10y", "15y", "20y", "30y", "40y", "from 50y")
SIDES = ("assets", "swaps", "liability")
RATES = (
    "Change of value for +1 bp at the nodes nearest to each tenor. A fall of the liability "
    "counts as a gain. The hedge ratio is the change of assets and swaps divided by that of the "
    "liability."
)
PRICES = (
    "IE01 is the same for +1 bp of the break-even at each tenor, with nominal rates held fixed."
)
RATES_TABLE = "Change for +1 bp, and hedge ratios: now, and after today's trades"
PRICES_TABLE = "Inflation: change for +1 bp of break-evens, and inflation hedge ratios"
REAL = (
    "With break-evens held fixed, a rise in nominal rates is also a rise in real rates. In the "
    "next table “Real rates” is the change of index-linked payments, which depend on real rates; "
    "“Nominal rates” is the change of all other payments."
)


@dataclass(frozen=True)
class Collateral:
    """The headroom now and after today's trades; None without swaps."""

    now: Headroom | None = None
    after: Headroom | None = None


@dataclass(frozen=True)
class TodayTables:
    """The trades; the ladders of rates and of break-evens, now and after the trades; collateral."""

    trades: TradeList
    ladder: CurveLadder
    ladder_after: CurveLadder
    inflation_ladder: CurveLadder
    inflation_ladder_after: CurveLadder
    collateral: Collateral


def measure(run: StudyRun) -> TodayTables:
    """All results are in closed form; they use the first decision on the recorded paths."""
    case, inputs, paths = case_of(run), plain(run.setup.problem.inputs), PATHS.of(run)
    assert paths is not None
    weights, digits = paths.first_decision.weights, paths.first_decision.overlay
    values, local = limit_unit(case), figures(case, inputs)
    requested = notionals(case, digits, values)
    now = np.zeros(0) if case.overlay is None else case.overlay.notional.used()
    after = _rebalanced(case, weights)
    return TodayTables(
        balance.trades(case, weights, digits, values),
        balance.ladder(case, inputs, local, now),
        balance.ladder(after, inputs, local, requested),
        balance.inflation_ladder(case, inputs, local, now),
        balance.inflation_ladder(after, inputs, local, requested),
        Collateral(
            balance.headroom(case, case.assets.weight.used(), now),
            balance.headroom(case, weights, requested),
        ),
    )


def _rebalanced(case: PensionCase, weights: np.ndarray) -> PensionCase:
    moved = replace(case.assets.weight, values=np.asarray(weights, np.float64))
    return replace(case, assets=replace(case.assets, weight=moved))


def show(run: PensionRun, result: TodayTables) -> Sequence[Block]:
    """Today's trades from the present weights to the policy's, and those of the swaps."""
    classes, swaps = result.trades.classes, result.trades.swaps
    scale, unit = run.size([x.trade for x in classes])
    body = [
        (
            x.name,
            _verb(x.trade, scale),
            points(x.now, 1),
            points(x.target, 1),
            f"{points(x.low, 0)} – {points(x.high, 0)}",
            number(x.trade / scale, 2, True),
            number(x.cost / scale, 3),
        )
        for x in classes
    ]
    names = (("Class", ""), ("", ""), ("Now", "%"), ("Policy", "%"), ("Bounds", "%"))
    head = [*names, ("Trade", unit), ("Cost", unit)]
    blocks: list[Block] = [Table(head, body, "Classes", 2)]
    if swaps:
        scale, unit = run.size([amount for x in swaps for amount in (x.now, x.target)])
        lines = [
            (
                x.tenor,
                _verb(x.trade, scale),
                number(x.now / scale, 2),
                number(x.target / scale, 2),
                number(x.trade / scale, 2, True),
            )
            for x in swaps
        ]
        head = [("Swap", ""), ("", ""), ("Now", unit), ("Policy", unit), ("Trade", unit)]
        blocks.append(Table(head, lines, "Receiver swaps: notionals", 2))
    return blocks


def _verb(trade: float, scale: float) -> str:
    if abs(trade) < 0.005 * scale:
        return "keep"
    return "buy" if trade > 0 else "sell"


TODAY = Chapter(
    "today", "Today's trades", TodayTables, measure, show, "Trades", ("paths",), anchor="trades"
)


def show_ladders(run: PensionRun, result: TodayTables) -> Sequence[Block]:
    """Key-rate ladders of assets, swaps and liabilities today, with hedge ratios by bucket."""
    rates = Buckets.of(run, result.ladder, result.ladder_after)
    blocks: list[Block] = [rates.picture("ladder", RATES), rates.table(RATES_TABLE)]
    prices = Buckets.of(run, result.inflation_ladder, result.inflation_ladder_after)
    if prices.used.size:
        blocks += [prices.picture("inflation-ladder", PRICES), prices.table(PRICES_TABLE)]
        blocks += [Text(REAL, caveat=True), _real(run, result)]
    return blocks


@dataclass(frozen=True)
class Buckets:
    """Changes of value by bucket, in money, `before` and `after` today's trades {side: [buckets]};
    `used` are the buckets with a change."""

    run: PensionRun
    before: dict[str, np.ndarray]
    after: dict[str, np.ndarray]

    @classmethod
    def of(cls, run: PensionRun, before: CurveLadder, after: CurveLadder) -> "Buckets":
        position = np.digitize(before.tenor, EDGES)

        def bucketed(values: np.ndarray) -> np.ndarray:
            values = np.nan_to_num(values) if values.size else np.zeros(len(position))
            return np.bincount(position, values, len(BUCKET_NAMES))

        sides = [{side: bucketed(getattr(x, side)) for side in SIDES} for x in (before, after)]
        return cls(run, *sides)

    @property
    def used(self) -> np.ndarray:
        both = (*self.before.values(), *self.after.values())
        return np.flatnonzero(sum(np.abs(item) for item in both) > 0)

    def picture(self, name: str, caption: str) -> Chart:
        used, (scale, unit) = self.used, self.run.size(*self.before.values())
        series = [
            Bars("Assets, policy", self.after["assets"][used] / scale, "inject"),
            Bars("Swaps, policy", self.after["swaps"][used] / scale, "withdraw"),
            Bars("Liability", self.before["liability"][used] / scale, "main"),
        ]
        labels = [BUCKET_NAMES[i] for i in used]
        alt = (
            "Change of the value of assets, swaps and liability for a rise of 1 bp, by tenor "
            "bucket."
        )
        svg = draw(name, alt, lambda axes: grouped(axes, labels, series, f"{unit} per bp"), 230)
        return Chart(svg, caption)

    def table(self, caption: str) -> Table:
        scale, unit = self.run.size(*self.before.values())
        rows = [self._line(BUCKET_NAMES[i], [i], scale) for i in self.used]
        rows.append(self._line("All", list(self.used), scale))
        head = [("Tenor", ""), ("Liability", unit), ("Assets now", unit), ("Swaps now", unit)]
        head += [("Hedge ratio now", "%"), ("Assets, policy", unit), ("Swaps, policy", unit)]
        head.append(("Hedge ratio, policy", "%"))
        return Table(head, rows, caption, 1, strong=frozenset([len(rows) - 1]))

    def _line(self, name: str, digits: list, scale: float) -> tuple[str, ...]:
        liability = float(self.before["liability"][digits].sum())
        cells = [name, number(liability / scale, 3, True)]
        for when in (self.before, self.after):
            held = [float(when[side][digits].sum()) for side in ("assets", "swaps")]
            cells += [number(item / scale, 3, True) for item in held]
            cells.append(number(100 * sum(held) / liability, 0) if abs(liability) > 0 else "")
        return tuple(cells)


def _real(run: PensionRun, result: TodayTables) -> Table:
    """The changes for +1 bp of all rates: of index-linked payments, of nominal payments, and of
    both."""
    parts = []
    for when, ladder in (("Now", result.ladder), ("After today's trades", result.ladder_after)):
        for side in ("assets", "liability"):
            names = (side, f"real_{side}")
            complete, real = (float(np.nan_to_num(getattr(ladder, x)).sum()) for x in names)
            parts.append((f"{when}: {side}", real, complete - real, complete))
    scale, unit = run.size(*(np.array(numbers) for _, *numbers in parts))
    rows = [(name, *(number(x / scale, 3, True) for x in numbers)) for name, *numbers in parts]
    head = [("", ""), ("Real rates", unit), ("Nominal rates", unit), ("Both", unit)]
    return Table(
        head, rows, "Change for +1 bp of all rates, with break-evens held fixed, without swaps", 1
    )


LADDERS = TODAY.section(
    "ladder", "Key-rate ladder and hedge ratios today", "Hedge ratios", show_ladders
)


def show_limits(run: PensionRun, result: PathTables) -> Sequence[Block]:
    """Today's headroom of the collateral, and by month the share of paths that violate a limit."""
    today, facts = TODAY.of(run), []
    collateral = Collateral() if today is None else today.collateral
    if (now := collateral.now) is not None:
        facts = [
            _headroom(run, "Headroom now", now),
            _headroom(run, "After today's trades", collateral.after),
            ("Required", f"{number(now.required, 0)} bp", "rise in rates that must be withstood"),
        ]
    broken = [(x, text, result.limits[x]) for x, text in BREACHES if x in result.limits]
    note = f"probability of at least one such month, {run.measure}"
    facts += [(label, share(breaches.ever, 2), note) for _, label, breaches in broken]
    blocks: list[Block] = [Facts(facts)]
    if now is None and not run.left_out(TODAY.name):
        blocks.append(Text("The case has no swaps, so it needs no collateral."))
    return [*blocks, *(_months(run, *breaches) for breaches in broken)]


def _months(run: PensionRun, name: str, label: str, breaches: LimitBreaches) -> Chart | Text:
    """Shares of the paths that break one limit, step by step."""
    months = breaches.share
    if not np.any(months > 0):
        return Text(f"{label}: on no path in any month.")
    worst = int(np.nanargmax(months))
    layer = Layer(label, 100 * months, "limit", 0.8)
    text = f"{label} most often in step {worst + 1}: on {share(months[worst], 2)} of the paths."
    years, unit = np.arange(len(months)) * run.step, "% of paths"
    svg = draw(f"breach-{name}", text, lambda axes: stack(axes, years, [layer], unit), 180)
    return Chart(svg, f"{text} Shares of the paths by month.")


def _headroom(run: PensionRun, name: str, room: Headroom | None) -> tuple[str, str, str]:
    if room is None or (room.headroom is None and not room.enough):
        return name, "no swaps", "no collateral is needed"
    note = f"{run.large(room.eligible)} eligible, PV01 {run.large(room.pv01, 2)}"
    if room.direction == "fall":
        note = f"{note}; for a fall in rates"
    enough = room.headroom is None
    return name, "no limit" if enough else f"{number(room.headroom, 0)} bp", note


LIMITS = PATHS.section("collateral", with_measure("Collateral and limits"), "Limits", show_limits)
