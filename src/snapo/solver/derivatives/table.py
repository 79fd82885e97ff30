"""The table of sensitivities: every derivative of a solution, with its interval."""

from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from snapo.problem.record import Input

from ..statistics import Estimate, plus_minus, rounded
from ..tables import frame, table
from .interval import Interval, Reported, Verdict, one_percent, plain

if TYPE_CHECKING:
    from snapo.problem.problem import Problem

HEAD = (
    "input", "label", "derivative", "low", "high", "per", "source", "± sampling", "± policy",
    "decisions held", "smooth rules", "",
)  # fmt: skip
SHOWN = 12  # numbers of one input that are printed
LEFT = (0, 1, 5, 6)  # columns of text


class SensitivityRow(NamedTuple):
    """One line of a sensitivity table: derivatives per one `unit` of the input.

    - `value`, `low`, `high`: the reported derivative and its 95 % interval; `sampling` and
      `policy`: the parts of the half-width due to the finite number of paths and to the error of
      the policy; `source`: "held", "through the policy", "range" or "not known" (see
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

    - `held`: those of the exact simulator, with decisions held fixed.
    - `smooth`: those through the policy's reaction, or None if not requested.
    - `moved`: the change of `held` since an earlier policy, or None.
    - `policy_gradient`: norm of the policy's gradient with the noise subtracted, and the norm of
      the noise.
    - `dropped`: the number of non-finite paths of either table, which are left out.
    - `verdicts`: the verdict of a bump of the input, {input: Verdict}.
    - `reported`: the reported derivative, with its interval, {input: Reported}; if None, it is the
      held one with its sampling error.
    - `of_inputs`: the held derivatives with respect to the inputs of another problem that has the
      same schedule; None if the derivatives with respect to the schedule are large.
    """

    inputs: dict[str, Input]
    held: dict[str, Estimate]
    smooth: dict[str, Estimate] | None = None
    moved: dict[str, Estimate] | None = None
    policy_gradient: tuple[float, float] | None = None
    dropped: int = 0
    verdicts: dict[str, Verdict] | None = None
    reported: dict[str, Reported] | None = None
    of_inputs: Callable[["Problem"], dict[str, Estimate]] | None = None

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
            raise KeyError(f"there is no input {name!r}; {hint}The inputs are {list(self.inputs)}.")
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
    """A half-width; empty if it is not finite."""
    return rounded(width, 2) if np.isfinite(width) else ""
