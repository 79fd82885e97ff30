"""Sensitivities: the effect of one unit more of every input, with an interval.

Two derivatives of one value come from adjoint passes. HELD: the exact simulator with the recorded
decisions replayed; if the decisions are optimal, depend on the whole state and cause no jump, it is
the derivative of the optimal value (envelope theorem). SMOOTH: the smooth simulator through the
policy's reaction, as used in training. The reported one is the held one, unless a bump of the exact
simulator refutes it (`derivatives.verdict`); its interval has room for the error of the policy
(`derivatives.margin`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from snapo.engine import Engine, Xla
from snapo.engine.base import Uncontrolled
from snapo.engine.xla import weighted_sum
from snapo.problem import inputs as inputs_
from snapo.problem.code.version import of_preparation, of_rollout, read_context, reading_once
from snapo.problem.meant import takes_problem
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import BLOCKS
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import EXACT, Exact, Smooth

from .adjoint import float64
from .derivatives.bump import FEWEST, one_percent
from .derivatives.by_block import DerivativePass
from .derivatives.interval import Interval, Reported
from .derivatives.verdict import Verdict, plain
from .statistics import Estimate, plus_minus, rounded
from .tables import frame, table


class SensitivityRow(NamedTuple):
    """One line of a sensitivity table: derivatives per one `unit` of the input.

    - `value`, `low`, `high`: the reported derivative and its 95 % interval; of the half-width
      `sampling` is due to the finite number of paths and `policy` to the error of the policy;
      `source`: "held", "through the policy", "range" or "not known" (see
      `derivatives.interval.Reported`).
    - `held` and `smooth`, each with its standard error; `moved`: the change of `held` in the second
      half of training, with its standard error. NaN for results that were not requested.
    """

    input: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    sampling: float
    policy: float
    source: str
    held: float
    held_error: float
    smooth: float
    smooth_error: float
    moved: float
    moved_error: float


class Sensitivities(NamedTuple):
    """Derivatives of the objective with respect to every input, {input: Estimate}.

    - `held`: exact simulator, with decisions held fixed.
    - `smooth`: through the policy's reaction, or None if not requested.
    - `moved`: the change of `held` since an earlier policy, or None.
    - `policy_gradient`: norm of the policy's gradient with the noise subtracted, and the norm of
      the noise.
    - `dropped`: the number of non-finite paths of either table, which are left out.
    - `verdicts`: the verdict of a bump of the input, {input: Verdict}.
    - `reported`: the reported derivative, with its interval, {input: Reported}; if None, it is the
      held one with its sampling error.
    - `of_inputs`: the held derivatives with respect to the inputs of another problem that has the
      same schedule; None if those with respect to the schedule are large.
    """

    inputs: dict[str, inputs_.Input]
    held: dict[str, Estimate]
    smooth: dict[str, Estimate] | None = None
    moved: dict[str, Estimate] | None = None
    policy_gradient: tuple[float, float] | None = None
    dropped: int = 0
    verdicts: dict[str, Verdict] | None = None
    reported: dict[str, Reported] | None = None
    of_inputs: Callable[[Problem], dict[str, Estimate]] | None = None

    def __getitem__(self, name: Any) -> Any:
        """The reported derivative with respect to an input, by its name."""
        return self.of(name) if isinstance(name, str) else tuple(self)[name]

    def of(self, name: str) -> Reported:
        """The reported derivative with respect to an input.

        **Raises:** `KeyError` for a name that is not an input.
        """
        if name not in self.inputs:
            near = get_close_matches(name, self.inputs, 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise KeyError(f"no input {name!r}; {hint}The inputs are {list(self.inputs)}.")
        if self.reported is not None:
            return self.reported[name]
        return plain(self.held[name], one_percent(self.inputs[name]))

    def source(self, name: str) -> str:
        """The source of the reported derivative with respect to an input."""
        return self.of(name).source

    def along(self, name: str, direction: np.ndarray) -> Interval:
        """The reported derivative along a direction of an input, with its interval."""
        return self.of(name).along(direction)

    def capped(self, gap: float) -> "Sensitivities":
        """The same table, with intervals for a policy whose value is within `gap` of the best one.

        Use the upper end of a certified gap, `snapo.bound(problem, policy).gap.high`, or the exact
        value minus that of the policy if it is known.
        """
        if self.reported is None:
            return self
        capped = {name: item.capped(gap) for name, item in self.reported.items()}
        return self._replace(reported=capped)

    def rows(self) -> Iterator[SensitivityRow]:
        """Every number of every input, in the order of the inputs."""
        for name, values in self.inputs.items():
            columns = [
                column
                for table in (self.held, self.smooth, self.moved)
                for column in _columns(table, name)
            ]
            nothing = np.full(values.value.size, np.nan)
            numbers = zip(*(nothing if column is None else column for column in columns))
            derivative = self.of(name)
            for label, interval, row in zip(values.names(), derivative.numbers(), numbers):
                yield SensitivityRow(
                    name, label, values.unit, *interval, derivative.source, *map(float, row)
                )  # fmt: skip

    def table(self) -> Any:
        """The rows as a pandas data frame, where pandas is installed; else a list of dicts."""
        rows = [row._asdict() for row in self.rows()]
        try:
            from pandas import DataFrame  # pyright: ignore[reportMissingImports]
        except ModuleNotFoundError:
            return rows
        return DataFrame(rows, columns=list(SensitivityRow._fields))

    def frame(self, backend: str = "pandas") -> Any:
        """The rows as a data frame of "pandas", "polars" or "pyarrow", a column for each field of
        a `SensitivityRow`."""
        rows = list(self.rows())
        return frame(
            {name: [row[i] for row in rows] for i, name in enumerate(SensitivityRow._fields)},
            backend,
        )

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """The table as text; of an input with many numbers, the largest ones."""
        lines = [HEAD, *(line for name in self.inputs for line in self._lines(name))]
        widths = [max(len(line[i]) for line in lines) for i in range(len(HEAD))]
        return "\n".join(
            "  ".join(
                cell.ljust(width) if i in LEFT else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(line, widths))
            ).rstrip()
            for line in lines
        )

    def _repr_html_(self) -> str:
        """The same table in a notebook."""
        return table(HEAD, (line for name in self.inputs for line in self._lines(name)), LEFT)

    def _lines(self, name: str) -> list[tuple[str, ...]]:
        """One input as lines of cells."""
        rows = [row for row in self.rows() if row.input == name]
        largest = sorted(rows, key=lambda row: -abs(np.nan_to_num(row.value)))[:SHOWN]
        lines: list[tuple[str, ...]] = [
            (
                row.input, row.label, _figure(row.value), _figure(row.low), _figure(row.high),
                f"/{row.unit}", row.source, _half(row.sampling), _half(row.policy),
                _figure(row.held), _figure(row.smooth), _error(row.smooth_error),
            )
            for row in rows if row in largest
        ]  # fmt: skip
        if len(rows) > SHOWN:
            more = f"and {len(rows) - SHOWN} smaller"
            lines.append((name, more, *("",) * (len(HEAD) - 2)))
        return lines


TEMPERATURE = 0.005  # at which a policy reacts in second derivatives
HEAD = (
    "input", "label", "derivative", "low", "high", "per", "source", "sampling", "policy", "held",
    "smooth", "",
)  # fmt: skip
SHOWN = 12  # numbers of one input that are printed
LEFT = (0, 1, 5, 6)  # columns of text
MINIMUM, MAXIMUM = 256, 64  # paths of a block where there are more than 32; blocks at most
DRIFT = 4  # a share of the blocks, one in four, is enough for the drift


def _columns(estimates: Mapping[str, Estimate] | None, name: str) -> tuple:
    """Derivatives with respect to an input and their errors, flat; None if there are none."""
    if estimates is None:
        return None, None
    return estimates[name].value.ravel(), estimates[name].standard_error.ravel()


def _figure(number: float) -> str:
    return f"{number:,.5g}" if np.isfinite(number) else ""


def _error(number: float) -> str:
    return plus_minus(number) if np.isfinite(number) else ""


def _half(width: float) -> str:
    """A half-width; that of an interval without one of its parts is a nought."""
    return rounded(width, 2) if np.isfinite(width) else ""


@takes_problem
@reading_once()
def sensitivities(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 16384,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
    smooth_paths: int = 4096,
    earlier: Policy | None = None,
    actions: np.ndarray | None = None,
    totals: Mapping[str, np.ndarray] | None = None,
) -> Sensitivities:
    """Derivatives with decisions held fixed, on `paths`; with `Smooth(temperature)` smooth ones.

    The latter use `smooth_paths`; all are paths of the problem's evaluation. Standard errors come
    from 32 to 64 independent blocks of paths. `earlier` is a policy from the middle of training:
    its held derivatives on the first of the same paths show how much they still changed. `actions`
    [T, paths, A] are the policy's decisions on these paths, and `totals` {output: [paths]} their
    totals, if they were recorded before.
    """
    return sensitivities_and_totals(
        problem, policy, paths, smooth, smooth_paths, earlier, engine, actions, totals
    )[0]


@reading_once()
def sensitivities_and_totals(
    problem: Problem,
    policy: Policy,
    paths: int,
    smooth: Smooth | Exact,
    smooth_paths: int,
    earlier: Policy | None,
    engine: Engine | None = None,
    actions: np.ndarray | None = None,
    totals: Mapping[str, np.ndarray] | None = None,
) -> tuple[Sensitivities, Totals | None]:
    """`sensitivities`, and the smooth simulator's totals {output: [smooth_paths]}; None if they
    were not asked for, or are not all finite."""
    bound = (engine or Xla(precision="float64")).bind(problem, controls=False)
    source = problem.sources.evaluation
    paths = source.available(paths)
    blocks = source.blocks(paths, int(np.clip(paths // MINIMUM, BLOCKS, MAXIMUM)))
    if isinstance(bound.simulator, Uncontrolled):
        totals = None  # a program without control variates may round in another way
    exact = DerivativePass(problem, bound, policy, Exact(), True, actions, totals=totals)
    held, moved = exact.derivatives(blocks), None
    if earlier is not None:
        # Paired, so that a few blocks suffice; the weights of another objective are those of all.
        few = blocks[: max(FEWEST, len(blocks) // DRIFT)] if problem.objective.linear else blocks
        before = DerivativePass(problem, bound, earlier, Exact(), held=True).derivatives(few).inputs
        moved = {
            name: Estimate(held.inputs[name].blocks[: len(few)] - item.blocks)
            for name, item in before.items()
        }
    result = Sensitivities(
        problem.inputs_by_name, held.inputs,
        moved=moved, dropped=held.dropped, of_inputs=held.of_others,
    )  # fmt: skip
    if isinstance(smooth, Exact):
        return _without(result, problem.lost), None
    blocks = source.blocks(source.available(min(smooth_paths, paths)))
    soft = through_policy(problem, policy, smooth, engine).derivatives(blocks)
    dropped, norm = held.dropped + soft.dropped, soft.policy.norm()
    result = result._replace(smooth=soft.inputs, policy_gradient=norm, dropped=dropped)
    table = soft.totals if not soft.dropped else None
    if table is not None:
        order = np.argsort(np.concatenate(blocks))
        table = {name: total[order] for name, total in table.items()}
    return _without(result, problem.lost), table


def through_policy(
    problem: Problem, policy: Policy, smooth: Smooth, engine: Engine | None
) -> DerivativePass:
    """How `sensitivities` differentiates the smooth simulator."""
    bound = (engine or Xla(precision="float64")).bind(problem, controls=False)
    return DerivativePass(problem, bound, policy, smooth, held=False)


def _without(result: Sensitivities, lost: tuple[str, ...]) -> Sensitivities:
    """A table without adjoint derivatives of the inputs that lose theirs (`Problem.lost`)."""

    def without_lost(table: dict[str, Estimate]) -> dict[str, Estimate]:
        unknown = {name: Estimate(np.full_like(table[name].blocks, np.nan)) for name in lost}
        return table | unknown

    smooth = None if result.smooth is None else without_lost(result.smooth)
    return result._replace(held=without_lost(result.held), smooth=smooth)


@takes_problem(objective=False)
def held_of_several(
    problem: Problem,
    policy: Policy,
    objectives: Sequence[Objective],
    *,
    paths: int,
    engine: Engine | None = None,
) -> list[dict[str, Estimate]]:
    """Held derivatives {input: Estimate} of each objective, as `sensitivities` gives of one.

    The objectives share the recorded decisions and every forward sweep: one adjoint pass for each
    block of paths has a column of cotangents for each objective.
    """
    bound, source = (engine or Xla(precision="float64")).bind(problem), problem.sources.evaluation
    path = DerivativePass(problem, bound, policy, Exact(), held=True)
    return [result.inputs for result in path.of(objectives, source.blocks(source.available(paths)))]


@takes_problem
def second_order(
    problem: Problem,
    policy: Policy,
    *,
    directions: Sequence[Mapping[str, np.ndarray]],
    paths: int = 4096,
    smooth: Smooth | Exact | None = None,
) -> list[dict[str, np.ndarray]]:
    """The change of derivatives along directions of the inputs (forward over reverse).

    The derivatives are those with decisions held fixed, but along a direction the decisions respond
    through the smooth policy: otherwise a value that is linear in prices has no second derivative.
    Directions and results are {input: array}; a direction is zero if not named. `smooth`:
    `Smooth(0.005)` by default. XLA only; weights are held fixed if the objective is not linear.
    """
    engine, simulator, inputs = Xla(precision="float64"), problem.simulator, problem.inputs
    smooth = smooth or Smooth(TEMPERATURE)
    draws = problem.sources.evaluation.draws(np.arange(paths), simulator)
    totals = float64(engine.bind(problem).values(policy, draws, smooth).totals)
    weights = problem.objective.weights(totals)
    names, values = list(problem.inputs_by_name), inputs_.values(inputs)
    bare, results = inputs_.unnamed(inputs), []
    for direction in directions:
        unknown = set(direction) - set(names)
        if unknown:
            raise KeyError(f"second_order: no input {sorted(unknown)}; the inputs are {names}.")
        along = [
            np.broadcast_to(np.asarray(direction.get(n, 0.0), float), v.shape)
            for n, v in zip(names, values)
        ]
        version = of_preparation(simulator, inputs), of_rollout(simulator, policy, problem.schedule)
        with engine.numbers(), read_context(version):
            moved = _second(engine, simulator, bare, policy, draws, smooth, weights, values, along)
            results.append({name: np.asarray(x) for name, x in zip(names, moved)})
    return results


@eqx.filter_jit
def _second(engine: Xla, simulator, inputs, policy, draws: Draws, smooth, weights, values, along):
    def made(values) -> Schedule:
        return simulator.prepare(inputs_.replace(inputs, values))

    def held_gradient(values):
        call = engine.call(simulator, policy, made(values), draws, smooth)
        actions = engine.traced(call, ("action",)).record["action"]
        actions = actions[..., : simulator.action.size]  # without a policy's memory

        def value(moved):
            replayed = engine.call(simulator, None, made(moved), draws, smooth, actions=actions)
            return weighted_sum(engine.traced(replayed).totals, weights)

        return jax.grad(value)(values)

    return jax.jvp(held_gradient, (values,), (along,))[1]
