"""`solution.plot`: the usual figures of a solution, as matplotlib figures for a notebook.

    solution.plot.tornado()
    solution.plot.distribution("cash").savefig("cash.pdf")
    solution.plot.fan("water")
    solution.plot.policy("water", "price")

They are drawn from the solution only, so that a loaded solution has them too. Each returns its
figure, which shows itself in a notebook; with `ax` it draws into these axes and returns nothing, so
that their figure is not shown twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.engine import Xla
from snapo.problem.code.version import followed, of_rollout
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact

from .derivatives.interval import MOVE
from .derivatives.table import Sensitivities
from .evaluate import simulate
from .learning.progress import Record

PATHS, POINTS, CELLS = 1024, 121, 61


def simulated_series(problem: Problem, policy: Policy, paths: int = PATHS) -> dict[str, np.ndarray]:
    """{name: [T or T + 1, paths]} of every number of the state, the action and the outputs."""
    trajectory = simulate(problem, policy, paths=paths)
    return {**trajectory.states, **trajectory.actions, **trajectory.outputs}


def series_named(series: dict[str, np.ndarray], name: str, subject: str) -> np.ndarray:
    """The series with this name.

    **Raises:** `KeyError` for an unknown name."""
    if name not in series:
        raise KeyError(f"plot.{subject}: there is no {name!r}; available: {sorted(series)}.")
    return series[name]


def decisions(
    problem: Problem, policy: Policy, names: tuple[str, ...], ranges: list[np.ndarray], step: int
) -> np.ndarray:
    """[points …, actions] exact decisions at a step, where one or two numbers of the state vary and
    all others are at their means."""
    source = problem.sources.evaluation
    draws = source.draws(np.arange(source.available(PATHS)), problem.simulator)
    record = Xla("float64").bind(problem).values(policy, draws, Exact(), record=("state",)).record
    middle = jax.tree.map(
        lambda x: jnp.asarray(np.asarray(x, np.float64)[step].mean(0), jnp.float32), record["state"]
    )
    schedule = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), problem.schedule)
    now = at(schedule.steps, step)

    def decide(*values: Any) -> Any:
        state = middle
        for name, value in zip(names, values):
            state = _put(state, name, value)
        observed = problem.simulator.observe(schedule.constants, now, state)
        return policy(observed, Exact())

    call = decide
    for axis in reversed(range(len(names))):
        call = jax.vmap(call, tuple(0 if i == axis else None for i in range(len(names))))
    grid = [jnp.asarray(item, jnp.float32) for item in ranges]
    version = of_rollout(problem.simulator, policy, schedule)
    return np.asarray(followed(jax.jit(call), version)(*grid), np.float64)


def _put(state: Any, name: str, value: Any) -> Any:
    """The state with one number replaced: "stock", "stock.0", or "state" of a plain array."""
    flat, tree = jax.tree_util.tree_flatten_with_path(state)
    leaves = []
    for path, leaf in flat:
        local = ".".join(str(getattr(part, "key", getattr(part, "idx", part))) for part in path)
        local = local or "state"
        if name == local and leaf.size == 1:
            leaf = jnp.reshape(value, leaf.shape)
        elif name.startswith(f"{local}.") and name[len(local) + 1 :].isdigit():
            leaf = leaf.ravel().at[int(name[len(local) + 1 :])].set(value).reshape(leaf.shape)
        leaves.append(leaf)
    return jax.tree.unflatten(tree, leaves)


INK, SOFT, BAD = "#1d3f72", "#c6d5ea", "#d55e00"
BARS, BINS = 15, 60


@dataclass(frozen=True, eq=False, repr=False)
class Figures:
    """The figures of one solution; needs matplotlib, installed by `pip install 'snapo[cli]'`.

    The fields are those of the solution.
    """

    _sensitivities: Sensitivities | None
    _totals: Mapping[str, np.ndarray]
    _history: Sequence[Record]
    _policy: Policy | None
    _problem: Problem | None

    def __repr__(self) -> str:
        names = "tornado(), distribution(output), training(), fan(name), policy(state)"
        return f"the figures of a solution: {names}"

    def tornado(self, *, ax: Any = None, count: int = BARS) -> Any:
        """The change of the value by a move of each input, largest first, with 95 % intervals.

        All numbers of an input are moved by its `move`, by default 1 %. The change is to first
        order, with the reported derivative.

        **Raises:** `ValueError` if the solution has no sensitivities.
        """
        sensitivities = self._sensitivities
        if sensitivities is None:
            raise ValueError("plot.tornado: this solution was made without sensitivities.")
        bars = []
        for name, values in sensitivities.inputs.items():
            if values.move:
                by, text = (
                    np.full(values.value.shape, values.move),
                    f"+{values.move:g} {values.unit}",
                )
            else:
                by, text = MOVE * values.value, "+1 %"
            interval = sensitivities.along(name, by)
            if np.isfinite(interval.value):
                bars.append((interval, f"{name} {text}".rstrip()))
        bars = sorted(bars, key=lambda bar: abs(bar[0].value))[-count:]
        figure, ax = _axes(ax, height=1.2 + 0.32 * len(bars))
        names = [name for _, name in bars]
        effects = [interval.value for interval, _ in bars]
        whiskers = [(x.value - x.low, x.high - x.value) for x, _ in bars]
        ax.barh(names, effects, color=[INK if effect >= 0 else BAD for effect in effects])
        spread = np.reshape(whiskers, (-1, 2)).T
        ax.errorbar(effects, names, xerr=spread, fmt="none", ecolor="black", lw=1)
        ax.axvline(0, color="black", lw=0.8)
        ax.set_xlabel("change of the value")
        return figure

    def distribution(self, output: str | None = None, *, ax: Any = None) -> Any:
        """The totals of an output over the evaluation's paths, with lines at the mean and at the 5
        % and 95 % quantiles.

        Without a name it is the output with the largest spread.

        **Raises:** `KeyError` for a name that is not an output.
        """
        totals = self._totals
        if output is None:
            output = max(totals, key=lambda name: float(np.nanstd(totals[name])))
        if output not in totals:
            raise KeyError(
                f"plot.distribution: there is no output {output!r}; available: {sorted(totals)}."
            )
        values = np.asarray(totals[output], np.float64)
        values = values[np.isfinite(values)]
        figure, ax = _axes(ax)
        ax.hist(values, BINS, color=SOFT, edgecolor=INK, lw=0.4)
        low, high = np.quantile(values, [0.05, 0.95])
        for position, text in ((low, "5 %"), (values.mean(), "mean"), (high, "95 %")):
            ax.axvline(position, color=INK, lw=1.2 if text == "mean" else 0.8)
            ax.annotate(
                f"{text}\n{position:,.4g}", (position, 1), xycoords=("data", "axes fraction"),
                xytext=(3, -3), textcoords="offset points", va="top", fontsize="small",
            )  # fmt: skip
        ax.set_xlabel(f"{output}, total of a path")
        ax.set_ylabel("paths")
        return figure

    def fan(self, name: str, problem: Problem | None = None, *, ax: Any = None) -> Any:
        """A state, an action or an output over time: the mean, and bands with 50 % and 90 % of
        1,024 paths of the evaluation.

        - `problem`: the problem of the solution; required for a loaded solution.

        **Raises:** `KeyError` for an unknown name, `ValueError` without a problem or a policy.
        """
        series = series_named(simulated_series(*self._played("fan", problem)), name, "fan")
        low, lower, upper, high = np.nanquantile(series, [0.05, 0.25, 0.75, 0.95], axis=1)
        steps = np.arange(len(series))
        figure, ax = _axes(ax)
        ax.fill_between(steps, low, high, color=SOFT, alpha=0.5, lw=0, label="90 % of paths")
        ax.fill_between(steps, lower, upper, color=SOFT, lw=0, label="50 % of paths")
        ax.plot(steps, np.nanmean(series, 1), color=INK, label="mean")
        ax.set_xlabel("step")
        ax.set_ylabel(name)
        ax.legend(frameon=False)
        return figure

    def policy(
        self, state: str, other: str | None = None, problem: Problem | None = None, *,
        step: int = 0, action: int = 0, ax: Any = None,
    ) -> Any:  # fmt: skip
        """The decision at a `step` against one number of the state, with the others at their means.

        Every action is a line; with a second number, `other`, the figure is a map of one `action`.
        The range is that of all paths at all steps; `problem` as in `fan`.

        **Raises:** `KeyError` for a name that is not a state, `ValueError` as for `fan`.
        """
        result, policy = self._played("policy", problem)
        names = (state,) if other is None else (state, other)
        series = simulated_series(result, policy)
        points = POINTS if other is None else CELLS
        ranges = []
        for name in names:
            low, high = np.nanquantile(series_named(series, name, "policy"), [0.005, 0.995])
            ranges.append(np.linspace(low, high, points))
        decided = decisions(result, policy, names, ranges, step)
        figure, ax = _axes(ax)
        if other is None:
            for i in range(decided.shape[1]):
                ax.plot(ranges[0], decided[:, i], label=f"action {i}")
            if decided.shape[1] > 1:
                ax.legend(frameon=False)
            ax.set_ylabel(f"decision at step {step}")
        else:
            mesh = ax.pcolormesh(ranges[0], ranges[1], decided[:, :, action].T, cmap="viridis")
            ax.figure.colorbar(mesh, ax=ax, label=f"action {action} at step {step}")
            ax.set_ylabel(other)
        ax.set_xlabel(state)
        return figure

    def _played(self, subject: str, problem: Problem | None) -> tuple[Problem, Policy]:
        """The problem and the policy, if there are both."""
        problem = problem or self._problem
        if problem is None:
            raise ValueError(
                f"plot.{subject}: a loaded solution needs a problem: {subject}(…, problem)."
            )
        if self._policy is None:
            raise ValueError(f"plot.{subject}: this solution was loaded without its policy.")
        return problem, self._policy

    def training(self, *, ax: Any = None) -> Any:
        """The smooth objective of every step, and the exact value at each validation."""
        history = self._history
        figure, ax = _axes(ax)
        steps = [record.step for record in history]
        smooth = [record.objective for record in history]
        ax.plot(steps, smooth, color=SOFT, label="smooth, at each step")
        # Between two validations the records repeat the last exact value: its first step counts.
        exact = {record.exact: record.step for record in reversed(history)}
        exact = {value: step for value, step in exact.items() if np.isfinite(value)}
        validated = list(exact.values())
        ax.plot(validated, list(exact), "o", color=INK, ms=4, label="exact, at each validation")
        ax.set_xlabel("step of training")
        ax.set_ylabel("objective")
        ax.legend(frameon=False)
        return figure


def _axes(ax: Any, height: float = 3.6) -> tuple[Any, Any]:
    """The figure and its axes: the supplied axes without a figure to return, or new ones.

    A new figure shows itself under the cell of a notebook, with any backend of matplotlib.
    """
    if ax is not None:
        return None, ax
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        message = "solution.plot needs matplotlib: pip install 'snapo[cli]'"
        raise ModuleNotFoundError(message) from None
    figure = Figure(figsize=(7.2, height), layout="constrained")
    # A kernel shows a bare figure as text unless `%matplotlib inline` has run; this is its picture.
    figure._repr_png_ = partial(_png, figure)  # pyright: ignore[reportAttributeAccessIssue]
    figure._repr_mimebundle_ = partial(_shown, figure)  # pyright: ignore[reportAttributeAccessIssue]
    ax = figure.subplots()
    ax.spines[["top", "right"]].set_visible(False)
    return figure, ax


def _png(figure: Any) -> bytes:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=144)
    return file.getvalue()


def _shown(figure: Any, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a notebook shows, in the size of the figure; no text that names a class."""
    width, height = (round(96 * size) for size in figure.get_size_inches())
    data = {"image/png": _png(figure), "text/plain": "a picture; savefig(file) writes it"}
    return data, {"image/png": {"width": width, "height": height}}
