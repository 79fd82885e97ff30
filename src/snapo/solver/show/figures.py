"""`solution.plot`: the usual figures of a solution, as matplotlib figures for a notebook.

    solution.plot.tornado()
    solution.plot.distribution("cash").savefig("cash.pdf")

They are drawn from the solution alone, so a loaded one has them too. Each takes `ax` to draw into,
and returns the figure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..judge import SMOOTH, hundredth

if TYPE_CHECKING:
    from ..solution import Solution

INK, SOFT, BAD = "#1d3f72", "#c6d5ea", "#d55e00"
BARS, BINS = 15, 60
SURE = 1.96  # standard errors of a bar's whisker


class Figures:
    """The figures of one solution; needs matplotlib, which `pip install 'snapo[cli]'` brings."""

    def __init__(self, solution: Solution):
        self._solution = solution

    def __repr__(self) -> str:
        return "the figures of a solution: tornado(), distribution(output), training()"

    def tornado(self, *, ax: Any = None, count: int = BARS) -> Any:
        """The change of the value by each input's move, largest first, with 95 % whiskers.

        The move is the input's own `move`, of all its numbers at once; without one, a hundredth of
        them. To first order, by the derivative that is believed, else by the held one.

        **Raises:** `ValueError` where the solution has no sensitivities.
        """
        found = self._solution.sensitivities
        if found is None:
            raise ValueError("plot.tornado: this solution was made without sensitivities.")
        bars = []
        for name, given in found.inputs.items():
            smooth = found.believed(name) == SMOOTH and found.smooth is not None
            estimate = (found.smooth if smooth else found.held)[name]  # pyright: ignore
            if given.move:
                by, words = np.full(given.value.shape, given.move), f"+{given.move:g} {given.unit}"
            else:
                by, words = hundredth(given), "+1 %"
            bars.append((*estimate.along(by), f"{name} {words}".rstrip()))
        bars = sorted(bars, key=lambda bar: abs(bar[0]))[-count:]
        figure, ax = _axes(ax, height=1.2 + 0.32 * len(bars))
        effects, errors, names = zip(*bars)
        ax.barh(names, effects, color=[INK if each >= 0 else BAD for each in effects])
        ax.errorbar(effects, names, xerr=SURE * np.array(errors), fmt="none", ecolor="black", lw=1)
        ax.axvline(0, color="black", lw=0.8)
        ax.set_xlabel("change of the value")
        return figure

    def distribution(self, output: str | None = None, *, ax: Any = None) -> Any:
        """The totals of an output over the evaluation's paths, with mean, and 5 % and 95 % lines.

        Without a name, the output with the largest spread.

        **Raises:** `KeyError` for a name that is no output's.
        """
        totals = self._solution.totals
        if output is None:
            output = max(totals, key=lambda name: float(np.nanstd(totals[name])))
        if output not in totals:
            raise KeyError(f"plot.distribution: no output {output!r}; there are {sorted(totals)}.")
        values = np.asarray(totals[output], np.float64)
        values = values[np.isfinite(values)]
        figure, ax = _axes(ax)
        ax.hist(values, BINS, color=SOFT, edgecolor=INK, lw=0.4)
        low, high = np.quantile(values, [0.05, 0.95])
        for place, words in ((low, "5 %"), (values.mean(), "mean"), (high, "95 %")):
            ax.axvline(place, color=INK, lw=1.2 if words == "mean" else 0.8)
            ax.annotate(
                f"{words}\n{place:,.4g}", (place, 1), xycoords=("data", "axes fraction"),
                xytext=(3, -3), textcoords="offset points", va="top", fontsize="small",
            )  # fmt: skip
        ax.set_xlabel(f"{output}, total of a path")
        ax.set_ylabel("paths")
        return figure

    def training(self, *, ax: Any = None) -> Any:
        """The smooth objective of every step, and the exact value at each validation."""
        history = self._solution.history
        figure, ax = _axes(ax)
        steps = [record.step for record in history]
        ax.plot(steps, [record.objective for record in history], color=SOFT, label="smooth, a step")
        # Between two validations the records repeat the last exact value: its first step counts.
        exact = {record.exact: record.step for record in reversed(history)}
        exact = {value: step for value, step in exact.items() if np.isfinite(value)}
        ax.plot(list(exact.values()), list(exact), "o", color=INK, ms=4, label="exact, validation")
        ax.set_xlabel("step of training")
        ax.set_ylabel("objective")
        ax.legend(frameon=False)
        return figure


def _axes(ax: Any, height: float = 3.6) -> tuple[Any, Any]:
    """The figure and its axes: those given, or new ones that no window shows twice."""
    if ax is not None:
        return ax.figure, ax
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        what = "solution.plot needs matplotlib: pip install 'snapo[cli]'"
        raise ModuleNotFoundError(what) from None
    figure = Figure(figsize=(7.2, height), layout="constrained")
    ax = figure.subplots()
    ax.spines[["top", "right"]].set_visible(False)
    return figure, ax
