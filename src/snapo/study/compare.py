"""Compares runs of one kind: values, settings, and sensitivities that differ."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.report.checksums import changed_files
from snapo.report.folder import RunResult
from snapo.solver import statistics
from snapo.solver.derivatives import solution_file
from snapo.solver.derivatives.interval import Interval, Reported
from snapo.solver.statistics import Estimate, rounded
from snapo.solver.tables import HALFWAY, POLICY, SOLUTION

from . import run_folder
from .run_folder import GROUPS, Difference, differences, in_words

MAXIMUM = 12  # sensitivities that a person sees; all of them are in the table
SHARE = 0.01  # of an input: by so much it is moved where it does not say its `move`


class DerivativePair(NamedTuple):
    """The reported derivative in both runs, per `unit` of the input.

    - `standard_error`: the standard error of the difference, from sampling; `policy`: the largest
      change of the difference due to the errors of both policies.
    - `sources`: the sources of the two derivatives (`Sensitivities.source`).
    - `effect`: the difference of the effects of the input's standard move on the two values.
    """

    input: str
    label: str
    unit: str
    first: float
    second: float
    difference: float
    standard_error: float
    policy: float
    effect: float
    sources: tuple[str, str]


@dataclass(frozen=True)
class Comparison:
    """The second run compared with the first.

    - `values`, `errors`: the values of the two runs and their standard errors; None if a run has no
      value.
    - `difference`, `standard_error`: second minus first, and its error; `paired`: whether both are
      on the same scenarios.
    - `why`: a clause on why the runs are paired or not.
    - `settings`: all settings that affect the numbers and are different.
    - `sensitivities`: the sensitivities that both runs have, with the largest differences first.
    """

    kind: str
    runs: tuple[Path, Path]
    values: tuple[float | None, float | None]
    errors: tuple[float | None, float | None]
    difference: float | None
    standard_error: float | None
    paired: bool
    why: str
    settings: tuple[Difference, ...]
    sensitivities: tuple[DerivativePair, ...]

    def table(self) -> dict[str, Any]:
        """The comparison as plain data."""
        return {
            "kind": self.kind,
            "runs": [str(run) for run in self.runs],
            "values": list(self.values),
            "standard_errors": list(self.errors),
            "difference": self.difference,
            "standard_error": self.standard_error,
            "paired": self.paired,
            "why": self.why,
            "settings": [setting._asdict() for setting in self.settings],
            "sensitivities": [sensitivity._asdict() for sensitivity in self.sensitivities],
        }

    def __str__(self) -> str:
        return "\n".join([*self._values(), "", *self._settings(), "", *self._sensitivities()])

    def _values(self) -> Iterator[str]:
        yield f"{self.kind}: {self.runs[0]} and {self.runs[1]}; ± is half of a 95 % interval"
        for name, value, error in zip(("first", "second"), self.values, self.errors):
            yield f"{name:<12}{_figure(value) or 'no value':>16} {_error(error)}".rstrip()
        if self.difference is not None:
            yield f"{'difference':<12}{_figure(self.difference):>16} {_error(self.standard_error)}"
        yield self.why

    def _settings(self) -> Iterator[str]:
        yield "settings that differ:" if self.settings else "the settings are the same"
        for setting in self.settings:
            yield f"  {setting.describe()}"

    def _sensitivities(self) -> Iterator[str]:
        if not self.sensitivities:
            yield "all sensitivities that both runs have are equal"
            return
        yield "largest differences of sensitivities (first, second, difference, policy error):"
        for sensitivity in self.sensitivities[:MAXIMUM]:
            name = f"{sensitivity.input} {sensitivity.label}".strip()
            numbers = f"{_figure(sensitivity.first):>14}{_figure(sensitivity.second):>14}"
            last = f"{_figure(sensitivity.difference):>14} {_error(sensitivity.standard_error)}"
            room = f" and {rounded(sensitivity.policy, 2)}" if sensitivity.policy > 0 else ""
            yield f"  {name:<32}{numbers}{last}{room} per {sensitivity.unit or '1'}"
        if len(self.sensitivities) > MAXIMUM:
            yield f"  and {len(self.sensitivities) - MAXIMUM} smaller differences"


def compare(first: Path, second: Path) -> Comparison:
    """Compares the second run with the first. **Raises:** `CaseError` if one is not a run of this
    version, or if their kinds differ.
    """
    records = [run_folder.read(run) for run in (first, second)]
    kinds = [record["kind"] for record in records]
    if kinds[0] != kinds[1]:
        message = (
            f'{first} is a run of kind "{kinds[0]}"; only runs of the same kind can be compared'
        )
        raise CaseError(str(second), "kind", kinds[1], message)
    for run, record in zip((first, second), records, strict=True):
        run_folder.check_whole(run, record, (GROUPS, SOLUTION, POLICY, HALFWAY))
        if changed_files(run, {run_folder.RESULT: record["result"]} if "result" in record else {}):
            message = (
                "this file was changed or damaged since it was written; run snapo solve again "
                "with --resume"
            )
            raise CaseError(str(run / run_folder.RESULT), "", None, message)
    results = [_result(run) for run in (first, second)]
    values = [result.value for result in results]
    errors = [result.standard_error for result in results]
    settings = [run_folder.decisive_settings(record["decides"]) for record in records]
    groups, why = _groups(first, second)
    error = _difference_error(groups, errors)
    difference = _less(values[1], values[0])
    return Comparison(
        kinds[0],
        (first, second),
        (values[0], values[1]),
        (errors[0], errors[1]),
        difference,
        None if difference is None else error,
        groups is not None,
        why,
        tuple(differences(settings[0], settings[1])),
        tuple(_sensitivities(first, second, groups is not None)),
    )


class Comparisons(NamedTuple):
    """Three or more runs: the differences of every other run from the first."""

    pairs: tuple[Comparison, ...]

    def table(self) -> dict[str, Any]:
        """The comparison as plain data; "comparisons" has one entry for every run after the
        first."""
        first, *others = [pair.table() for pair in self.pairs]
        every = [first, *others]
        columns = {name: [first[name][0]] for name in ("runs", "values", "standard_errors")}
        for name, column in columns.items():
            column += [pair[name][1] for pair in every]
        return {"kind": first["kind"], **columns, "comparisons": every}

    def __str__(self) -> str:
        return "\n".join([*self._values(), "", *self._settings(), "", *self._sensitivities()])

    def _values(self) -> Iterator[str]:
        first = self.pairs[0]
        yield f"{first.kind}: ± is half of a 95 % interval"
        yield f"{'':<4}{'value':>16}{'':>12}{'minus the first':>18}{'':>12}  run"
        yield _line(1, (first.values[0], first.errors[0]), (None, None), f"{first.runs[0]}")
        for number, pair in enumerate(self.pairs, 2):
            change = pair.difference, pair.standard_error
            text = str(pair.runs[1]) if pair.paired else f"{pair.runs[1]} (other scenarios)"
            yield _line(number, (pair.values[1], pair.errors[1]), change, text)

    def _settings(self) -> Iterator[str]:
        names = dict.fromkeys(x.name for pair in self.pairs for x in pair.settings)
        yield "settings that differ (in the order of the runs):" if names else "same settings"
        for name in names:
            settings = [{x.name: x for x in pair.settings}.get(name) for pair in self.pairs]
            first = next(x.first for x in settings if x is not None)
            values = [first, *(first if x is None else x.second for x in settings)]
            if name.startswith("files."):
                order = list(dict.fromkeys(values))
                yield f"  {name}: version {', '.join(str(1 + order.index(x)) for x in values)}"
            else:
                yield f"  {name}: {', '.join(map(in_words, values))}"

    def _sensitivities(self) -> Iterator[str]:
        """The sensitivities with the largest differences in any pair of runs."""
        table: dict[tuple[str, str], dict[int, DerivativePair]] = {}
        for position, pair in enumerate(self.pairs):
            for item in pair.sensitivities:
                table.setdefault((item.input, item.label), {})[position] = item
        ranked = sorted(table.items(), key=lambda x: -max(abs(y.effect) for y in x[1].values()))
        head = "largest differences of sensitivities (-: equal, or missing in one of the runs):"
        yield head if ranked else "all sensitivities that both runs have are equal"
        for (name, label), items in ranked[:MAXIMUM]:
            one = next(iter(items.values()))
            values = [items[i].second if i in items else None for i in range(len(self.pairs))]
            cells = "".join(f"{_figure(value) or '-':>14}" for value in values)
            text = f"{name} {label}".strip()
            yield f"  {text:<32}{_figure(one.first):>14}{cells} per {one.unit or '1'}"


def _line(number: int, value: Sequence[float | None], change: Sequence[float | None], run: str):
    cells = f"{_figure(value[0]) or 'no value':>16} {_error(value[1]):<11}"
    return f"{number:<4}{cells}{_figure(change[0]):>18} {_error(change[1]):<11}  {run}"


def compare_all(runs: Sequence[Path]) -> Comparison | Comparisons:
    """Compares the second run, or every further run, with the first. **Raises:** `CaseError` as in
    `compare`, and for a single run.
    """
    if len(runs) < 2:
        message = "name two runs or more; `snapo runs CASE` lists the runs of a case"
        raise CaseError("RUN", "", str(runs[0]), message)
    pairs = tuple(compare(runs[0], other) for other in runs[1:])
    return pairs[0] if len(pairs) == 1 else Comparisons(pairs)


def difference(first: Path, second: Path) -> tuple[float | None, float | None, bool]:
    """The value of the second run minus that of the first, its standard error, and whether the two
    have the same scenarios.

    **Raises:** `CaseError` if one of them has no result.
    """
    results = [_result(run) for run in (first, second)]
    groups, _ = _groups(first, second)
    error = _difference_error(groups, [result.standard_error for result in results])
    return _less(results[1].value, results[0].value), error, groups is not None


def _less(value: float | None, other: float | None) -> float | None:
    return None if value is None or other is None else value - other


def _result(run: Path) -> RunResult:
    file = run / run_folder.RESULT
    table = run_folder.read_table(file)
    if table is None:
        message = "the run has no result yet; `snapo solve --resume` continues it"
        raise CaseError(str(file), "", None, message)
    return RunResult.of(table)


def _groups(first: Path, second: Path) -> tuple[np.ndarray | None, str]:
    """The differences between the values of every group of paths, if the scenarios are the same."""
    try:
        results = [solution_file.load_named(run / GROUPS) for run in (first, second)]
    except solution_file.CheckpointError:
        return None, "independent: one of the runs has no values for groups of paths"
    (one, ours), (other, theirs) = results
    for key, text in (("source", "scenarios"), ("noise", "noise"), ("paths", "numbers of paths")):
        if ours[key] != theirs[key]:
            return None, f"independent: the runs have different {text}"
    return other["groups",] - one["groups",], "paired: both runs have the same scenarios"


def _difference_error(groups: np.ndarray | None, errors: list[float | None]) -> float | None:
    """The standard error of the difference of the values."""
    if groups is not None and groups.size > 1:
        return statistics.of_shares(groups).standard_error
    if errors[0] is None or errors[1] is None:
        return None
    return float(statistics.independent(errors[0], errors[1]))


def _sensitivities(first: Path, second: Path, paired: bool) -> list[DerivativePair]:
    """Reported derivatives that differ, sorted by the difference in the effect of the input's
    standard move. Derivatives that are missing in one of the runs are omitted."""
    try:
        one, other = (solution_file.sensitivities_in(run / SOLUTION) for run in (first, second))
    except solution_file.CheckpointError:
        return []
    if one is None or other is None:
        return []
    results: list[DerivativePair] = []
    for name in one.held:
        if name in other.held:
            results += _of_input(one.inputs[name], name, one.of(name), other.of(name), paired)
    return sorted(results, key=lambda item: -abs(item.effect))


def _of_input(
    inputs, name: str, first: Reported, second: Reported, paired: bool
) -> list[DerivativePair]:
    """The pairs of one input, entry by entry; nothing if the shapes of the input differ."""
    one, other = first.estimate, second.estimate
    if first.value.shape != second.value.shape:
        return []
    if paired and one.blocks.shape == other.blocks.shape:
        errors = Estimate(other.blocks - one.blocks).standard_error
    else:
        errors = statistics.independent(one.standard_error, other.standard_error)
    numbers = [Interval(*np.transpose(run.numbers())) for run in (first, second)]
    values = [run.value for run in numbers]
    difference, policy = values[1] - values[0], numbers[0].policy + numbers[1].policy
    moves = np.ravel(np.abs(inputs.value) * SHARE) if inputs.move is None else inputs.move
    sources = first.source, second.source
    columns = (*values, difference, np.ravel(errors), policy, difference * moves)
    rows = zip(inputs.names(), *(np.ravel(column).tolist() for column in columns))
    return [
        DerivativePair(name, label, inputs.unit, a, b, change, error, policy, effect, sources)
        for label, a, b, change, error, policy, effect in rows
        if np.isfinite(change) and change != 0
    ]


def _figure(number: float | None) -> str:
    return "" if number is None else f"{number:,.6g}"


def _error(number: float | None) -> str:
    """A standard error as half of a 95 % interval."""
    if number is None or not np.isfinite(number):
        return ""
    return statistics.plus_minus(number)
