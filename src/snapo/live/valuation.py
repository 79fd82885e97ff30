"""The trained policy of a run, valued at other inputs: what the page shows.

Every number is that of `snapo solve` of the moved case with the same policy, seed and numbers of
paths, to the bits: the same functions on the same scenarios, with guide and control variate of the
new case.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy
from snapo.problem.smooth import Smooth
from snapo.solver import statistics
from snapo.solver.by_block.passes import Way
from snapo.solver.evaluate import Value, estimate, path_totals, worth_of_groups
from snapo.solver.sensitivity import sensitivities
from snapo.solver.solution import Solution
from snapo.solver.train import begin, train
from snapo.study.parts.profile import MOST_ENTRIES, bands, leaves
from snapo.study.study import Setup, Study

from .counts import Counts
from .files import Files
from .places import Places
from .rolled import Rolled, roll
from .terms import derivatives, described, slopes

HEALTH_PATHS = 2048
TOLD = 12  # times that a training tells how far it is
Values = Mapping[str, np.ndarray]


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
        setup, policy = self._at(changed), self.solution.policy
        assert policy is not None
        rolled = roll(setup, policy, self.counts)
        yield "value", self._value(setup, rolled, changed)
        yield "deltas", self._deltas(setup, rolled)
        if self.study.today is not None:
            yield "today", self.study.today(setup, policy)._asdict()
        yield "fans", fans(rolled.shown)
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
        before, _ = self._totals_worth(setup)
        after, found = self._totals_worth(setup, state.best)
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

    def _value(self, setup: Setup, rolled: Rolled, changed: Values) -> dict[str, Any]:
        groups, found = _worth(setup, rolled.totals)
        if self._base is None:
            self._base = groups if not changed else self._totals_worth(self.setup)[0]
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

    def _totals_worth(self, setup: Setup, policy: Policy | None = None):
        """`_worth` of a policy, by default the run's."""
        policy = policy or self.solution.policy
        assert policy is not None
        engine = setup.engines.evaluate
        return _worth(setup, path_totals(setup.problem, policy, self.counts.value, engine=engine))

    def _deltas(self, setup: Setup, rolled: Rolled) -> list[dict[str, Any]]:
        policy = self.solution.policy
        assert policy is not None
        found = sensitivities(
            setup.problem, policy, self.counts.deltas,
            engine=setup.engines.evaluate, actions=rolled.actions,
        )  # fmt: skip
        return derivatives(found.held, setup.problem.named)

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


def fans(shown: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Bands over time of every number of state and outputs, and of the actions."""
    found = []
    for kind, record in shown.items():
        for name, values in leaves(record).items():
            values = np.asarray(values, np.float64)
            values = values.reshape(*values.shape[:2], -1)
            if values.shape[2] > MOST_ENTRIES:
                continue
            for i in range(values.shape[2]):
                full = (name or kind) + (f".{i}" if values.shape[2] > 1 else "")
                found.append({"name": full, "kind": kind, **bands(values[:, :, i])})
    return found


def _worth(setup: Setup, totals: Totals) -> tuple[np.ndarray, Value]:
    """The shares of independent groups of paths, and the value that they make."""
    problem = setup.problem
    given = problem.objective, totals, problem.sources.evaluation
    controls = problem.simulator.control_variates()
    return worth_of_groups(*given, controls), estimate(*given, controls)


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
