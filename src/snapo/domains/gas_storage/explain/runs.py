"""The two runs of an explained change, and the case of the first run on the date of the second
run."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from snapo.case.error import CaseError
from snapo.problem.scenarios import Pseudo, Scenarios
from snapo.problem.simulator import Simulator
from snapo.report.checksums import changed_files
from snapo.report.folder import RunResult
from snapo.solver.derivatives import solution_file
from snapo.solver.solution import POLICY, SOLUTION
from snapo.study import run_folder
from snapo.study.domain import find, installed
from snapo.study.kind import Kind
from snapo.study.prepare import case_of_run

from ..contract.records import StorageCase
from ..read.case import read_case

FIXED = "snapo explain needs flows that are decided at delivery: leave out this key"


@dataclass(frozen=True, eq=False)
class ValuedRun:
    """A finished run: its case, and the value in its result.json.

    - `shares` [G]: the shares of independent groups of paths in the value, None if they are not
      saved.
    """

    folder: Path
    file: Path
    data: Mapping[str, Any]
    case: Any
    engine: Any
    value: float
    error: float
    shares: np.ndarray | None

    @classmethod
    def read(cls, folder: Path) -> "ValuedRun":
        """The run in a folder.

        **Raises:** `CaseError` if the run has no value, was changed, or is of a kind whose changes
        cannot be split.
        """
        record = run_folder.read(folder)
        domain = find(record["kind"], str(folder))
        if not explains(domain):
            allowed = ", ".join(f'"{kind}"' for kind in explained_kinds())
            message = f"only runs of these kinds can be explained: {allowed}"
            raise CaseError(str(folder), "kind", record["kind"], message)
        run_folder.check_whole(folder, record, (POLICY, SOLUTION, run_folder.GROUPS))
        if "result" in record and changed_files(folder, {run_folder.RESULT: record["result"]}):
            message = (
                "this file was changed after it was written: run snapo solve again with --resume"
            )
            raise CaseError(str(folder / run_folder.RESULT), "", None, message)
        result = RunResult.read(folder)
        if result.value is None or result.standard_error is None:
            message = "this run has no value with a standard error: solve its case again"
            raise CaseError(str(folder), "", None, message)
        file, data = case_of_run(folder, record)
        case = domain.read(file, data)
        engine = record["decides"].get("options", {}).get("engine", "auto")
        numbers = result.value, result.standard_error
        run = cls(folder, file, data, case, engine, *numbers, _shares(folder))
        run.check()
        return run

    def check(self) -> None:
        """**Raises:** `CaseError` if a change of the value of this run cannot be split."""
        case = self.case
        if not case.days:
            raise CaseError(str(self.file), "contract.end", case.end, "no decision is left")
        if case.objective.kind != "mean":
            message = 'only the change of a mean can be explained: it must be "mean"'
            raise CaseError(str(self.file), "objective.kind", case.objective.kind, message)
        if case.model.calendar:
            message = FIXED
            key = next((x for x in ("nomination", "auction") if x in self.data["contract"]), "")
            raise CaseError(str(self.file), f"contract.{key}", None, message)
        if case.model.sources(0) is not None:
            message = "the paths of this model are supplied, and cannot move with the market"
            raise CaseError(str(self.file), "model.kind", case.model.kind, message)


def explains(domain: Any) -> bool:
    """Whether a change between two runs of this kind can be split into parts."""
    return isinstance(domain, Kind) and bool(domain.explainer)


def explained_kinds() -> list[str]:
    """The kinds of runs between which a change can be split into parts."""
    return [kind for kind in installed() if explains(find(kind, kind))]


def _shares(folder: Path) -> np.ndarray | None:
    try:
        return solution_file.load_named(folder / run_folder.GROUPS)[0]["groups",]
    except (solution_file.CheckpointError, KeyError):
        return None


def check_pair(first: ValuedRun, second: ValuedRun) -> None:
    """**Raises:** `CaseError` if the second run cannot follow the first one."""
    one, other = first.case, second.case
    if one.kind != other.kind:
        message = f'{first.folder} is of kind "{one.kind}": both runs must be of the same kind'
        raise CaseError(str(second.file), "kind", other.kind, message)
    if other.valuation_date < one.valuation_date:
        message = (
            f"it is before that of {first.folder}, {one.valuation_date}: name the earlier run first"
        )
        date = other.valuation_date
        raise CaseError(str(second.file), "market.valuation_date", date, message)
    for key in ("currency", "volume_unit"):
        if getattr(one, key) != getattr(other, key):
            message = f"{first.folder} has {getattr(one, key)!r}: both must have the same unit"
            raise CaseError(str(second.file), key, getattr(other, key), message)
    ends = [getattr(case, "end", case.days[-1]) for case in (one, other)]
    if other.days != one.days[len(one.days) - len(other.days) :] or ends[0] != ends[1]:
        span = f"{one.days[0]} to {one.days[-1]}"
        message = f"the decision days of {first.folder}, {span}, do not end with those of this case"
        raise CaseError(str(second.file), "contract", None, message)


def on_date_of(first: ValuedRun, second: ValuedRun, inventory: float) -> StorageCase:
    """The case of the first run on the valuation date of the second run, with `inventory` in store.

    Its prices, model, rates and terms are those of the first run, day by day; the settings of
    training and evaluation are those of the second run.
    """
    one, other = first.case, second.case
    contract = dict(first.data["contract"]) | {"inventory": inventory}
    contract.pop("first_decision", None)
    if "first_decision" in second.data["contract"]:
        contract["first_decision"] = second.data["contract"]["first_decision"]
    market = dict(first.data["market"]) | {"valuation_date": other.valuation_date}
    case = read_case(first.file, dict(first.data) | {"contract": contract, "market": market})
    curve = one.market.forward_curve
    count = len(case.market.forward_curve.values)
    values = curve.used()[len(curve.index) - count :]
    case = with_curve(case, values)
    settings = {name: getattr(other, name) for name in ("training", "evaluation", "objective")}
    return replace(case, **settings)


def with_curve(case: StorageCase, prices: np.ndarray) -> StorageCase:
    """The case with these forward prices for its days."""
    curve = replace(case.market.forward_curve, values=prices, index=np.arange(len(prices)))
    model: Any = case.model
    model = eqx.tree_at(lambda x: x.delivery.curve, model, curve)
    return replace(case, market=replace(case.market, forward_curve=curve), model=model)


@dataclass(frozen=True)
class LaterPaths(Pseudo):
    """The paths of a simulator for an earlier date, continued by a simulator for a later date: the
    noise of each day is the same.

    - `first`: the step of the earlier calendar at which a simulator of the later date begins.
    """

    first: int = 0

    def draws(self, paths: np.ndarray, simulator: Simulator):
        begins_later = 0 < simulator.first_step <= simulator.initial_steps
        return self.counter(paths, self.first, simulator.initial_steps if begins_later else 0)


def later_paths(
    source: Scenarios, earlier: Simulator, later: Simulator, passed: int
) -> LaterPaths | None:
    """The paths of `earlier` after the first `passed` of its days; None if the scenarios cannot be
    shifted in this way."""
    if type(source) is not Pseudo:
        return None
    starts = [x.first_step if x.first_step <= x.initial_steps else 0 for x in (earlier, later)]
    first = starts[0] + passed
    return LaterPaths(source.seed, source.antithetic, source.stream, max(first, starts[1]))
