"""The trained policy of a run, valued at other inputs: what the page shows.

Every number is that of `snapo solve` of the moved case with the same policy, seed and numbers of
paths, to the bits: the same functions on the same scenarios, with guide and control variate of the
new case.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.policy import Policy
from snapo.problem.smooth import Exact, Smooth
from snapo.solver import statistics
from snapo.solver.by_block.passes import Way
from snapo.solver.evaluate import Value, estimate, path_totals, worth_of_groups
from snapo.solver.sensitivity import sensitivities
from snapo.solver.solution import Solution
from snapo.solver.solve import Evaluation
from snapo.solver.train import begin, train
from snapo.study.parts.profile import MOST_ENTRIES, bands, leaves
from snapo.study.study import Setup, Study

from .files import Files
from .places import Places
from .terms import derivatives, described, slopes

FEWEST, MOST = 2048, 12288  # paths of the value: as many as its error needs
ENOUGH = 0.0012  # standard error over value; at moved inputs it may be a little larger
DELTA_PATHS, FAN_PATHS, HEALTH_PATHS = 2048, 1024, 2048
TOLD = 12  # times that a training tells how far it is
Values = Mapping[str, np.ndarray]


class Counts(NamedTuple):
    """Paths: of the value, of the derivatives, of the fans."""

    value: int = MOST
    deltas: int = DELTA_PATHS
    fans: int = FAN_PATHS

    @classmethod
    def of(cls, paths: int, deltas: int | None = None) -> "Counts":
        """So many paths for the value, and no more for anything else."""
        return cls(paths, min(DELTA_PATHS, deltas or paths, paths), min(FAN_PATHS, paths))

    @classmethod
    def enough(cls, solution: Solution, evaluation: Evaluation) -> "Counts":
        """As many paths as a run's own error says that the value needs, and no more than it had."""
        share = solution.standard_error / max(abs(solution.value), 1e-300) / ENOUGH
        needed = min(MOST, max(FEWEST, evaluation.paths * min(share, 1e3) ** 2))
        paths = min(evaluation.paths, 512 * math.ceil(needed / 512))
        return cls.of(paths, evaluation.sensitivity_paths)


class Valuation:
    """A run, ready to be valued at other inputs."""

    def __init__(self, study: Study, solution: Solution, places: Places, counts: Counts):
        if study.moved is None:
            what = f'inputs of a run of kind "{study.kind}" cannot be moved yet'
            raise CaseError("snapo open", "", None, what)
        assert study.setup is not None
        self.study, self.solution, self.places, self.counts = study, solution, places, counts
        self.setup = study.setup()
        self.named = self.setup.problem.named
        self.slopes = slopes(solution.sensitivities, self.named)
        self._base: np.ndarray | None = None
        self._trained: tuple[float, float] | None = None

    def inputs(self) -> list[dict[str, Any]]:
        """All inputs of the case, as the page shows them."""
        table = self.solution.sensitivities
        return [
            described(name, given, self.slopes[name], table.believed(name) if table else "")
            for name, given in self.named.items()
        ]

    def units(self) -> dict[str, Any]:
        """`unit` of the value, and `units` of states and outputs by name, where they are known."""
        about = self.study.about
        return {"unit": about.get("value_unit", ""), "units": dict(about.get("units", {}))}

    def changed(self, values: Values) -> dict[str, np.ndarray]:
        """The inputs that differ from the run's, shaped like them.

        **Raises:** `CaseError` for a name that is no input's, or numbers that do not fit.
        """
        found = {}
        for name, value in values.items():
            given = self.named.get(name)
            if given is None:
                raise CaseError(name, "", None, "there is no such input")
            new = np.asarray(value, np.float64)
            if new.size != given.value.size or not np.isfinite(new).all():
                what = f"this input has {given.value.size} finite numbers"
                raise CaseError(name, "", None, what)
            new = new.reshape(given.value.shape)
            if not np.array_equal(new, given.value):
                found[name] = new
        return found

    def files(self, values: Values) -> Files:
        """The files of the case with these numbers, so that `snapo solve` finds what is shown."""
        files, paths = self.places.moved(self.changed(values)).files, self.counts
        files = files.without(self.study.checks)
        table = dict(files.tables.get("evaluation", {}))
        table |= {"paths": paths.value, "sensitivity_paths": paths.deltas}
        return files.with_value(("evaluation",), table)

    def stages(self, values: Values) -> Iterator[tuple[str, Any]]:
        """(name, table) one after another: value, deltas, today, fans, health.

        **Raises:** `CaseError` where the case's own reader refuses the numbers.
        """
        changed = self.changed(values)
        setup = self._at(changed)
        yield "value", self._value(setup, changed)
        yield "deltas", self._deltas(setup)
        if self.study.today is not None and self.solution.policy is not None:
            yield "today", self.study.today(setup, self.solution.policy)._asdict()
        yield "fans", self._fans(setup)
        yield "health", self._health(setup)

    def train_again(self, values: Values, told: Callable[[int, int], None]) -> dict[str, Any]:
        """The policy trained on at these inputs, and what that gains on the same paths.

        It starts from the run's policy, which stays the one that the page values. `told` hears of
        the steps done and of all; what it raises ends the training.
        """
        setup, policy = self._at(self.changed(values)), self.solution.policy
        assert policy is not None
        steps = setup.training.steps
        training = replace(setup.training, validation_every=max(1, steps // TOLD))
        state = begin(policy, training)
        told(0, steps)
        state = train(
            setup.problem, state, training, setup.engines.train,
            [lambda progress: told(progress.step, steps)],
        )  # fmt: skip
        before, _ = self._worth(setup, policy)
        after, found = self._worth(setup, state.best)
        gain = statistics.of_shares(after - before)
        return {
            "value": found.value,
            "standard_error": found.standard_error,
            "gain": gain.value,
            "gain_error": gain.standard_error,
            "steps": state.step,
            "status": state.status,
        }

    def _at(self, changed: Values) -> Setup:
        """The setup at the inputs that differ from the run's, read from the case they make."""
        moved = self.places.moved(changed)
        if not changed:
            return self.setup
        assert self.study.moved is not None
        return self.study.moved(self.setup, moved.case)

    def _value(self, setup: Setup, changed: Values) -> dict[str, Any]:
        policy = self.solution.policy
        assert policy is not None
        groups, found = self._worth(setup, policy)
        if self._base is None:
            self._base = groups if not changed else self._worth(self.setup, policy)[0]
        change = statistics.of_shares(groups - self._base)
        first = {
            name: float(self.slopes[name] @ (new - self.named[name].value).ravel())
            for name, new in changed.items()
        }
        return {
            "value": found.value,
            "standard_error": found.standard_error,
            "paths": setup.problem.sources.evaluation.available(self.counts.value),
            "change": change.value if changed else 0.0,
            "change_error": change.standard_error if changed else 0.0,
            "predicted": sum(first.values()),
            "by_input": first,
        }

    def _worth(self, setup: Setup, policy: Policy) -> tuple[np.ndarray, Value]:
        """The shares of independent groups of paths, and the value that they make."""
        problem = setup.problem
        source, controls = problem.sources.evaluation, problem.simulator.control_variates()
        totals = path_totals(problem, policy, self.counts.value, engine=setup.engines.evaluate)
        groups = worth_of_groups(problem.objective, totals, source, controls)
        return groups, estimate(problem.objective, totals, source, controls)

    def _deltas(self, setup: Setup) -> list[dict[str, Any]]:
        policy = self.solution.policy
        assert policy is not None
        found = sensitivities(
            setup.problem, policy, self.counts.deltas, engine=setup.engines.evaluate
        )
        return derivatives(found.held, setup.problem.named)

    def _fans(self, setup: Setup) -> list[dict[str, Any]]:
        """Bands over time of every number of state and outputs, and of the actions."""
        problem, policy = setup.problem, self.solution.policy
        source = problem.sources.evaluation
        draws = source.draws(np.arange(source.available(self.counts.fans)), problem.simulator)
        bound = setup.engines.evaluate.bind(problem)
        kinds = ("state", "action", "outputs")
        rolled = bound.values(policy, draws, Exact(), record=kinds)
        found = []
        for kind in kinds:
            for name, values in leaves(rolled.record[kind]).items():
                values = np.asarray(values, np.float64)
                values = values.reshape(*values.shape[:2], -1)
                if values.shape[2] > MOST_ENTRIES:
                    continue
                for i in range(values.shape[2]):
                    full = (name or kind) + (f".{i}" if values.shape[2] > 1 else "")
                    found.append({"name": full, "kind": kind, **bands(values[:, :, i])})
        return found

    def _health(self, setup: Setup) -> dict[str, Any]:
        """How far the policy is from its best here, against where it was trained.

        The norm of the gradient of the smooth value by the policy, which vanishes at the best.
        """
        here = self._slope(setup)
        if self._trained is None:
            self._trained = here if setup is self.setup else self._slope(self.setup)
        return {"gradient": here[0], "noise": here[1], "at_training": self._trained[0]}

    def _slope(self, setup: Setup) -> tuple[float, float]:
        problem, policy = setup.problem, self.solution.policy
        assert policy is not None
        smooth = Smooth(np.float64(setup.training.temperature(setup.training.steps)))
        source = problem.sources.evaluation
        blocks = source.blocks(source.available(min(HEALTH_PATHS, self.counts.value)), 8)
        bound = setup.engines.evaluate.bind(problem)
        return Way(problem, bound, policy, smooth, held=False).derivatives(blocks).policy.norm()


def open_run(
    run: Path,
    simulator: tuple[str, str] | None = None,
    engine: str = "auto",
    counts: Counts | None = None,
) -> Valuation:
    """The run in a folder, its case read again and its policy loaded.

    **Raises:** `CaseError` where there is no such run, no policy, or nothing to move.
    """
    from snapo.study.again import case_of_run
    from snapo.study.commands import domain_of_run
    from snapo.study.domain import Options
    from snapo.study.run_folder import read

    from .files import read_files

    record = read(run)
    domain = domain_of_run(run, record, simulator)
    file, data = case_of_run(run, record)
    study = domain.study(domain.read(file, data), Options(engine))
    if study.setup is None:
        what = "this run trained no policy, and there is none to value again"
        raise CaseError(str(run), "", None, what)
    setup = study.setup()
    solution = Solution.load(run, like=setup.policy)
    places = Places(domain.read, read_files(file.parent, data), setup.problem.named)
    counts = counts or Counts.enough(solution, setup.evaluation)
    return Valuation(study, solution, places, counts)
