"""Ladders of today's balance sheet: +1 bp at each tenor of rates and of break-evens, and hedges."""

from dataclasses import dataclass

import numpy as np

from snapo.report.bands import Bars, grouped
from snapo.report.drawing import draw
from snapo.report.page import Block, Chart, Missing, Section, Table, Text
from snapo.report.quantity import number

from .run import PensionRun

EDGES = (3.5, 7.5, 12.5, 17.5, 25.0, 35.0, 45.0)  # years: half-way between the tenors named
BUCKET_NAMES = ("to 3y", "5y", "10y", "15y", "20y", "30y", "40y", "50y up")
SIDES = ("assets", "swaps", "liability")
RATES = (
    "Change of value for +1 bp at the nodes nearest to each tenor. A liability that falls is a"
    " gain: the hedge ratio is the assets' and swaps' change over the liability's."
)
PRICES = "IE01: the same for +1 bp of break-evens at each tenor, nominal rates held."
RATES_TABLE = "Change for +1 bp, and hedge ratios: now, and after today's trades"
PRICES_TABLE = "Inflation: change for +1 bp of break-evens, and inflation hedge ratios"
REAL = (
    "With break-evens held, a rise of nominal rates is one of real rates: the part of the rate"
    " ladder that pays the price index follows. The rest follows nominal rates alone."
)


def ladder(run: PensionRun) -> Section:
    """Key-rate ladders of assets, swaps and liabilities today, with hedge ratios by bucket."""
    title, short = "Key-rate ladder and hedge ratios today", "Hedge ratios"
    rates = Ladder.of(run, "ladder")
    if rates is None:
        text = "The key-rate ladder is not in this run."
        return Section("ladder", title, short, [Missing(text)])
    blocks: list[Block] = [rates.picture("ladder", RATES), rates.table(RATES_TABLE)]
    prices = Ladder.of(run, "inflation_ladder")
    if prices is not None and prices.used.size:
        blocks += [prices.picture("inflation-ladder", PRICES), prices.table(PRICES_TABLE)]
        blocks += [Text(REAL, caveat=True), _real(run)]
    return Section("ladder", title, short, blocks)


@dataclass(frozen=True)
class Ladder:
    """Changes by bucket, money, `before` and `after` today's trades {side: [buckets]}; `used` are
    the buckets where something moves."""

    run: PensionRun
    before: dict[str, np.ndarray]
    after: dict[str, np.ndarray]

    @classmethod
    def of(cls, run: PensionRun, name: str) -> "Ladder | None":
        tenor = run.numbers(f"{name}.tenor")
        if not run.get(name) or tenor is None:
            return None
        place = np.digitize(tenor, EDGES)

        def bucketed(path: str) -> np.ndarray:
            values = run.numbers(path)
            values = np.zeros(len(tenor)) if values is None else np.nan_to_num(values)
            return np.bincount(place, values, len(BUCKET_NAMES))

        sides = [
            {side: bucketed(f"{name}{when}.{side}") for side in SIDES} for when in ("", "_after")
        ]
        return cls(run, *sides)

    @property
    def used(self) -> np.ndarray:
        both = (*self.before.values(), *self.after.values())
        return np.flatnonzero(sum(np.abs(each) for each in both) > 0)

    def picture(self, name: str, caption: str) -> Chart:
        used, (scale, unit) = self.used, self.run.size(*self.before.values())
        series = [
            Bars("Assets, policy", self.after["assets"][used] / scale, "inject"),
            Bars("Swaps, policy", self.after["swaps"][used] / scale, "withdraw"),
            Bars("Liability", self.before["liability"][used] / scale, "main"),
        ]
        labels = [BUCKET_NAMES[i] for i in used]
        alt = "Change of value for a rise of 1 bp by tenor bucket, of assets, swaps and liability."
        svg = draw(name, alt, lambda axes: grouped(axes, labels, series, f"{unit} per bp"), 230)
        return Chart(svg, caption)

    def table(self, caption: str) -> Table:
        scale, unit = self.run.size(*self.before.values())
        rows = [self._line(BUCKET_NAMES[i], [i], scale) for i in self.used]
        rows.append(self._line("All", list(self.used), scale))
        head = [("Tenor", ""), ("Liability", unit), ("Assets now", unit), ("Swaps now", unit)]
        head += [("Hedge ratio", "%"), ("Assets, policy", unit), ("Swaps, policy", unit)]
        head.append(("Hedge ratio", "%"))
        return Table(head, rows, caption, 1, strong=frozenset([len(rows) - 1]))

    def _line(self, name: str, places: list, scale: float) -> tuple[str, ...]:
        liability = float(self.before["liability"][places].sum())
        cells = [name, number(liability / scale, 3, True)]
        for when in (self.before, self.after):
            held = [float(when[side][places].sum()) for side in ("assets", "swaps")]
            cells += [number(each / scale, 3, True) for each in held]
            cells.append(number(100 * sum(held) / liability, 0) if abs(liability) > 0 else "")
        return tuple(cells)


def _real(run: PensionRun) -> Table:
    """+1 bp of all rates: what pays prices, what pays money, and both."""

    def total(path: str) -> float:
        values = run.numbers(path)
        return 0.0 if values is None else float(np.nan_to_num(values).sum())

    parts = [("ladder", "Now"), ("ladder_after", "After today's trades")]
    found = []
    for name, when in parts:
        for side in ("assets", "liability"):
            whole, real = total(f"{name}.{side}"), total(f"{name}.real_{side}")
            found.append((f"{when}: {side}", real, whole - real, whole))
    scale, unit = run.size(*(np.array(each[1:]) for each in found))
    rows = [(name, *(number(each / scale, 3, True) for each in rest)) for name, *rest in found]
    head = [("", ""), ("Real rates", unit), ("Nominal rates", unit), ("Both", unit)]
    return Table(head, rows, "Change for +1 bp of all rates, break-evens held, without swaps", 1)
