"""The result of `solve` as frozen data: the value, its computation, and its reliability."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from snapo.problem.carry.latest import LATEST, followed
from snapo.problem.carry.save import PolicyFileError, load, stored
from snapo.problem.carry.save import save as save_policy
from snapo.problem.policy import Policy, features
from snapo.problem.problem import Problem

from .derivatives import solution_file
from .derivatives.table import Sensitivities, SensitivityRow
from .derivatives.verdict import COLUMNS
from .figures import Figures
from .learning.bar import in_notebook
from .learning.conditioning import Growth
from .learning.progress import Record
from .limits import LimitFound
from .statistics import plus_minus, rounded
from .tables import (
    GROWTH,
    HALFWAY,
    HISTORY,
    POLICY,
    RESULT,
    SENSITIVITIES,
    SOLUTION,
    TRAINING,
    VERDICTS,
    SheetTable,
    flat,
    frame,
    histogram,
    paragraph,
    sensitivities_chart,
    write_csv,
    write_tables,
    write_text,
)


@dataclass(frozen=True)
class Solution:
    """The result of `solve`.

    - `value`, `standard_error`: the objective of the EXACT simulator on fresh scenarios.
    - `smoothing_gap`: exact minus smooth value, on the first of the same paths, with its standard
      error `smoothing_gap_error`; `smooth_value`: the value minus the gap.
    - `policy`: the reported policy; `selected`: "start" (the rule that training began with),
      "newest", "highest" of the validation or "top of the surface"; `gain`: the gain of the best
      policy of a training over its start, with the standard error, on separate paths.
    - `policy_gradient_norm`: the norm of the policy's gradient, which vanishes at an optimum. The
      noise in it, `policy_gradient_noise`, has been subtracted: a norm below its noise may be zero.
    - `sensitivities`: the derivative with respect to every input, with its interval.
    - `totals`: {output: [paths]} of the exact simulator; `history`: the history of the training.
    - `seconds`: {compile, train, evaluate, total}; `engine` and `reason`: the engine used, and why.
    - `status`: "trained", "stopped early", "interrupted" (by Ctrl-C) or "diverged" (too many paths
      of a step are non-finite; see the notes); unless interrupted or diverged, "ruined" if the
      value is minus infinity and "not finite" if it is NaN.
    - `roles`: {training, validation, evaluation, sensitivities}: the paths used for each role.
    - `convergence`: "converged", "still improving", "too short to tell", "saturated" (the decision
      stays at a limit), "constant" (a constant decision does as well), "barely moved" (the
      untrained network does as well), "as good as its start" (the rule that training began with
      does as well) or "start kept" (that rule is reported); empty if the value is non-finite.
    - `growth`: adjoints by step and by part of the state, if training measured them; `window`,
      `clip` and `keep` at the end of training: the length of the windows for backpropagation, the
      bound on each path's adjoint (None: without), and the share of it passed on at each step.
    - `problem`: the problem that was solved, needed for figures over time; None in a loaded
      solution.
    - `constraints`: the constraints of the problem on fresh paths, with their shadow prices.
    - `maximised`: the objective as text, "mean of cash"; empty in a solution saved without it.
    - `dropped`: {train, evaluate, sensitivities}: the number of non-finite paths, which are left
      out; `notes`: remarks on the value.
    - `folder`: the folder from which the solution was loaded.
    """

    value: float
    standard_error: float
    smooth_value: float
    smoothing_gap: float
    policy: Policy | None
    policy_gradient_norm: float
    sensitivities: Sensitivities | None
    totals: Mapping[str, np.ndarray]
    history: tuple[Record, ...]
    seconds: Mapping[str, float]
    engine: str
    reason: str
    paths: Mapping[str, int]
    seed: int
    status: str
    control: float = 0.0
    policy_gradient_noise: float = float("nan")
    dropped: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    convergence: str = ""
    halfway: Policy | None = None
    growth: Growth | None = None
    window: int | None = None
    clip: float | None = None
    keep: float = 1.0
    versions: Mapping[str, str] = field(default_factory=dict)
    roles: Mapping[str, str] = field(default_factory=dict)
    problem: Problem | None = field(default=None, repr=False, compare=False)
    constraints: tuple[LimitFound, ...] = ()
    smoothing_gap_error: float = float("nan")
    selected: str = ""
    gain: tuple[float, float] = (float("nan"), float("nan"))
    maximised: str = ""
    folder: Path | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        table = [] if self.sensitivities is None else ["", str(self.sensitivities)]
        return "\n".join([*self.lines(), *table])

    def _repr_html_(self) -> str:
        """The same in a notebook."""
        sensitivities = self.sensitivities
        text = "".join(map(paragraph, self.lines()))
        return text if sensitivities is None else text + sensitivities._repr_html_()

    @property
    def plot(self) -> Figures:
        """Figures for a notebook: `plot.tornado()`, `plot.distribution()`, `plot.training()`,
        `plot.fan(name)`, `plot.policy(state)`."""
        return Figures(self.sensitivities, self.totals, self.history, self.policy, self.problem)

    def frame(self, table: str = "totals", backend: str = "pandas") -> Any:
        """A table as a data frame of "pandas", "polars" or "pyarrow".

        `table`: "totals", a row for each path and a column for each output; "history", a row for
        each step of training; or "sensitivities", a row for each number of every input.

        **Raises:** `ValueError` for another table, or if there were no sensitivities.
        """
        if table == "sensitivities" and self.sensitivities is not None:
            return self.sensitivities.frame(backend)
        if table == "totals":
            return frame({name: np.asarray(total) for name, total in self.totals.items()}, backend)
        if table == "history":
            columns = zip(*self.history) if self.history else ((),) * len(Record._fields)
            return frame(dict(zip(Record._fields, map(list, columns))), backend)
        message = "it must be 'totals', 'history', or 'sensitivities' if the solution has them"
        raise ValueError(f"frame: {table!r}; {message}.")

    def write_table(self, file: Path | str) -> None:
        """Writes the results as a workbook (.xlsx): a sheet for each table, with native charts.

        **Raises:** `ValueError` for another suffix, `ModuleNotFoundError` without openpyxl.
        """
        file = Path(file)
        if file.suffix.lower() != ".xlsx":
            raise ValueError(f"write_table: {file.name!r}; it must be a name that ends in .xlsx.")
        tables = {"result": SheetTable(("what", "value"), list(flat(self.summary())))}
        if self.sensitivities is not None:
            rows = list(self.sensitivities.rows())
            chart = sensitivities_chart(rows)
            tables["sensitivities"] = SheetTable(SensitivityRow._fields, rows, chart)
        if self.history:
            tables["training"] = SheetTable(Record._fields, self.history, TRAINING)
        tables |= {f"total {name}": histogram(total) for name, total in self.totals.items()}
        write_tables(file, tables)

    def report(self, file: Path | str, problem: Problem | None = None) -> Path:
        """Writes the report of this solution into an HTML file, and returns its path.

        A solution from `snapo solve` has the report of its run. For any other solution the report
        measures fans over time and checks the derivatives on `problem`, by default the problem
        that was solved.

        **Raises:** `ValueError` for a name that does not end in .html, or without a problem;
        `ModuleNotFoundError` without the extra `cli`.
        """
        with _pages("report", "cli") as pages:
            return pages.write_report(self, Path(file), problem)

    def open(
        self,
        problem: Problem | None = None,
        *,
        simulator: str | None = None,
        browser: bool | None = None,
    ) -> Any:
        """Opens the live page: every input can be moved, and the value is computed again.

        The page is served until `close()` of the returned page, or until this session ends.

        - `problem`: by default the problem that was solved; `simulator`: "MODULE:CLASS", for a run
          of `snapo solve` with a user-defined simulator.
        - `browser`: whether to open one; by default outside of a notebook, which shows a link.

        **Raises:** `ValueError` without a problem; `ModuleNotFoundError` without the extra `live`.
        """
        browser = not in_notebook() if browser is None else browser
        with _pages("open", "live") as pages:
            return pages.open_page(self, problem, simulator, browser)

    def lines(self) -> list[str]:
        """A summary of the value and the training, in a few lines."""
        gap = f"smooth {rounded(self.smooth_value, 6)}, gap {rounded(self.smoothing_gap, 3)}"
        if np.isfinite(self.smoothing_gap_error):
            gap = f"{gap} {plus_minus(self.smoothing_gap_error)}"
        status = ", ".join(filter(None, (self.status, self.convergence)))
        stages = [(name, value) for name, value in self.seconds.items() if name != "total"]
        seconds = ", ".join(f"{name} {value:.1f} s" for name, value in stages)
        paths = ", ".join(f"{count:,} to {stage}" for stage, count in self.paths.items())
        return [
            f"value {self.value:,.6g} {plus_minus(self.standard_error, 3)} (95 %; {gap}), {status}",
            *([f"maximised: {self.maximised}"] if self.maximised else []),
            f"engine {self.engine}: {self.reason}",
            f"paths: {paths}; seed {self.seed}; time: {seconds}",
            *map(str, self.constraints),
            *self.notes,
        ]

    def summary(self) -> dict[str, Any]:
        """The result as plain data, for JSON."""
        return {
            "value": self.value,
            "standard_error": self.standard_error,
            "smooth_value": self.smooth_value,
            "smoothing_gap": self.smoothing_gap,
            "smoothing_gap_error": self.smoothing_gap_error,
            "selected": self.selected,
            "gain": self.gain[0],
            "gain_error": self.gain[1],
            "policy_gradient_norm": self.policy_gradient_norm,
            "policy_gradient_noise": self.policy_gradient_noise,
            "dropped": dict(self.dropped),
            "notes": list(self.notes),
            "seconds": dict(self.seconds),
            "engine": self.engine,
            "paths": dict(self.paths),
            "roles": dict(self.roles),
            "seed": self.seed,
            "status": self.status,
            "convergence": self.convergence,
            "window": self.window,
            "clip": self.clip,
            "keep": self.keep,
            "adjoints": "" if self.growth is None else self.growth.describe(),
            "limits": [constraint._asdict() for constraint in self.constraints],
        }

    def save(self, folder: Path | str) -> None:
        """Writes result.json, tables as CSV (sensitivities, verdicts, history), and all arrays."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / RESULT, json.dumps(self.summary() | self._beside(), indent=1))
        if self.sensitivities is not None:
            write_csv(folder / SENSITIVITIES, SensitivityRow._fields, self.sensitivities.rows())
            verdicts = (self.sensitivities.verdicts or {}).items()
            write_csv(folder / VERDICTS, COLUMNS, (item.row(name) for name, item in verdicts))
        write_csv(folder / HISTORY, Record._fields, self.history)
        if self.growth is not None:
            write_csv(folder / GROWTH, self.growth.columns, self.growth.table())
        observed = None if self.problem is None else self.problem.interface.features
        for name, policy in ((POLICY, self.policy), (HALFWAY, self.halfway)):
            if policy is not None:
                save_policy(policy, folder / name, observed or features(policy), code=True)
        header = (
            self.summary() | self._beside() | solution_file.about_sensitivities(self.sensitivities)
        )
        header |= {
            "policy": self.policy is not None,
            "history": self.history,
            "growth": self.growth,
        }
        arrays = solution_file.arrays_of(self.totals, self.sensitivities)
        solution_file.save_named(folder / SOLUTION, arrays, header)

    @classmethod
    def load(cls, folder: Path | str, like: Policy | None = None) -> "Solution":
        """The solution that was saved in a folder; nothing in it is executed.

        The folder is that of `solution.save` or of a run of `snapo solve`, or the folder above a
        run. A policy of a user-defined class is stored without its code: `like` is such a policy,
        of the same shape; without it the solution has no policy.

        **Raises:** `CheckpointError` if a file is missing or damaged, or contains a policy that
        differs from `like` in shape, activation or action set.
        """
        folder = folder_of(folder)
        try:
            return cls._read(folder, like)
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            message = f"{folder / SOLUTION}: this is not the file of a solution ({error})."
            raise solution_file.CheckpointError(message) from None

    @classmethod
    def _read(cls, folder: Path, like: Policy | None) -> "Solution":
        arrays, header = solution_file.load_named(folder / SOLUTION)
        names = {"policy": POLICY, "halfway": HALFWAY}
        policies: dict[str, Any] = {
            name: _policy(folder / file, like) if header[name] else None
            for name, file in names.items()
        }
        totals = {name: array for (kind, name), array in arrays.items() if kind == "total"}
        sensitivities = solution_file.sensitivities_of(arrays, header) if header["inputs"] else None
        history = tuple(Record(*record) for record in header["history"])
        plain: dict[str, Any] = {name: header[name] for name in PLAIN}
        plain["notes"] = tuple(plain["notes"])
        plain["constraints"] = tuple(LimitFound(**limit) for limit in header["limits"])
        plain["growth"] = Growth.read(header["growth"])
        plain |= {
            name: header[name] for name in ("window", "clip", "keep", "maximised") if name in header
        }
        plain["gain"] = (header["gain"], header["gain_error"])
        plain |= {"totals": totals, "sensitivities": sensitivities, "history": history}
        return cls(**plain, **policies, folder=folder)

    def _beside(self) -> dict[str, Any]:
        """Plain data that is not in the summary."""
        return {
            "reason": self.reason,
            "control": self.control,
            "maximised": self.maximised,
            "versions": dict(self.versions),
            "halfway": self.halfway is not None,
        }


PLAIN = (
    "value", "standard_error", "smooth_value", "smoothing_gap", "policy_gradient_norm",
    "policy_gradient_noise", "dropped", "notes", "seconds", "engine", "reason", "paths", "seed",
    "status", "convergence", "control", "versions", "roles", "smoothing_gap_error", "selected",
)  # fmt: skip


@contextmanager
def _pages(verb: str, extra: str) -> Iterator[Any]:
    """The module that makes pages, from a package above this one; a missing library names its
    extra."""
    try:
        yield import_module("snapo.domains.own.in_python")
    except ModuleNotFoundError as error:
        message = f"solution.{verb} needs {error.name}: pip install 'snapo[{extra}]'"
        raise ModuleNotFoundError(message, name=error.name) from None


def folder_of(folder: Path | str) -> Path:
    """The folder with a solution: this one, or that of the run in the folder of a case."""
    folder = followed(Path(folder))
    latest = followed(folder / LATEST)
    inside = not (folder / SOLUTION).exists() and (latest / SOLUTION).exists()
    return latest if inside else folder


def _policy(file: Path, like: Policy | None) -> Policy | None:
    """The policy of a file; None if its class is user code and there is no `like`."""
    try:
        if like is None:
            return stored(file, Policy).policy
        return load(file, Policy, like)
    except PolicyFileError as error:
        raise solution_file.CheckpointError(str(error)) from None
