"""The trained policy of a run, valued at other inputs, for the page.

The value is bit for bit equal to that of `snapo solve` for the moved case with the same policy,
seed and numbers of paths. The same functions run on the same scenarios, with the value table and
the control variate of the moved case. Each derivative is that of the run, plus the change of the
derivative with decisions held fixed.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from snapo.case.error import CaseError
from snapo.problem.carry.save import PolicyFileError
from snapo.problem.objective import Totals
from snapo.problem.policy import Policy, load_policy
from snapo.problem.smooth import Smooth
from snapo.solver import statistics
from snapo.solver.adjoint import finite
from snapo.solver.bound import bound
from snapo.solver.derivatives.by_block import DerivativePass
from snapo.solver.evaluate import Value, estimate, finite_totals, value_of_groups
from snapo.solver.sensitivity import sensitivities
from snapo.solver.solution import Solution
from snapo.solver.statistics import Estimate
from snapo.solver.train import initial_progress, train
from snapo.study.chapters.profile import KINDS, MAX_ENTRIES, bands, leaves
from snapo.study.positions import InputPositions, movable
from snapo.study.run_folder import POLICY
from snapo.study.study import DisplayedValue, PathTotals, Setup, Study

from .moves import NONE, InputValues, Rebuild, SelectedChoices, WhatIf, explained_by
from .rollout import PathCounts, Simulated, simulate, totals_of
from .terms import MAXIMUM, Deltas, derivatives, no_value, slopes

HEALTH_PATHS, BOUND_PATHS = 1024, 512
TOLD = 12  # progress reports of one training


class Valuation(WhatIf):
    """A run with a policy, ready to be valued at other inputs."""

    def __init__(
        self,
        study: Study,
        solution: Solution,
        positions: InputPositions,
        counts: PathCounts,
        rebuilt: Rebuild,
    ):
        assert study.setup is not None
        self.setup = study.setup()
        super().__init__(study, self.setup.problem.inputs_by_name, positions, rebuilt)
        self.solution, self.counts = solution, counts
        assert solution.policy is not None
        self.policy: Policy = solution.policy  # that is valued: the run's, or one trained here
        self._policies: list[Policy] = [self.policy]
        known = slopes(solution.sensitivities, self.setup.problem.inputs_by_name)
        known |= {name: x.matrix.T @ known[x.input] for name, x in positions.sources.items()}
        self.slopes = {name: known[name] for name in self.inputs_by_name}
        self._base: np.ndarray | None = None
        self._held: dict[str, Estimate] | None = None
        self._trained: tuple[float, float] | None = None
        self._variants: dict[str, tuple[Study, Setup]] = {}
        self._last = self.setup

    def use(self, policy: int | str) -> None:
        """Selects the policy to value from now on: by its number among the policies trained on the
        page (0 is the run's policy), or by its file.

        **Raises:** `CaseError` for a policy that was lost with the process that trained it, or a
        file with another kind of policy.
        """
        if isinstance(policy, str):
            try:
                loaded = load_policy(policy)
            except PolicyFileError as error:
                raise CaseError("this policy", "", None, str(error)) from None
            if not _alike(loaded, self._policies[0]):
                raise CaseError(
                    "this policy",
                    "",
                    None,
                    "its kinds of decisions differ from those of the run's policy",
                )
            self.policy = loaded
            return
        if not 0 <= policy < len(self._policies):
            message = (
                "this policy was lost when the calculation that trained it ended; use the "
                "run's policy"
            )
            raise CaseError("this policy", "", None, message)
        self.policy = self._policies[policy]

    @property
    def is_adopted(self) -> bool:
        """Whether the valued policy is not the policy of the run."""
        return self.policy is not self.solution.policy

    def save_policy(self, folder: Path) -> None:
        """Saves, next to a case, a policy that was trained on the page; the policy of the run is
        already in the run.

        **Raises:** `CaseError` for a policy of a user-defined class that no file can contain.
        """
        if self.is_adopted:
            try:
                self.policy.save(folder / POLICY)
            except PolicyFileError as error:
                raise CaseError(POLICY, "", None, str(error)) from None

    def headline(self, value: float) -> DisplayedValue | None:
        if self.study.headline is None or not np.isfinite(value):
            return None
        return self.study.headline(self._last, value)

    def source(self, name: str) -> str:
        table, made = self.solution.sensitivities, self.positions.sources.get(name)
        return table.source(made.input if made else name) if table else ""

    def counted(self) -> dict[str, int]:
        return self.counts._asdict()

    def settings(self) -> dict[str, Any]:
        return {"paths": self.counts.value, "sensitivity_paths": self.counts.deltas}

    def stages(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> Iterator[tuple[str, Any]]:
        """Yields the value, the sections of the domain, the deltas, today's decision, and the
        fans."""
        changed = self.changed(values)
        study, setup = self._at(values, selected)
        policy, differs = self.policy, bool(changed or selected or self.is_adopted)
        rollout = simulate(setup, policy, self.counts)
        if differs and (invalid := _too_many(setup, rollout.totals)):
            raise self._no_value(changed, selected, invalid)
        self._last = setup
        yield "value", self._value(setup, rollout, changed, differs)
        if study.live_tables is not None:
            source = setup.problem.sources.evaluation
            groups = source.groups(np.arange(source.available(self.counts.value)))
            result = study.live_tables(PathTotals(setup, rollout.totals, groups))
            yield "sections", [item._asdict() for item in result]
        yield "deltas", self._deltas(setup, rollout, differs)
        if study.today is not None:
            yield "today", study.today(setup, policy)._asdict()
        yield "fans", fans(rollout.tables, study.names)

    def afterwards(self) -> Iterator[tuple[str, Any]]:
        """Yields the policy's distance from its optimum at the numbers that were valued last."""
        yield "health", self._health(self._last)

    def train_again(
        self,
        values: InputValues,
        summary: Callable[[int, int], None],
        selected: SelectedChoices = NONE,
    ) -> dict[str, Any]:
        """The policy after further training at these inputs, and its gain on the same paths.

        Training starts from the policy in use. The page continues to value that policy until it
        requests the new one by its number, "policy". `summary` is called with the number of
        completed steps and the number of all steps; an exception in it stops training.
        """
        setup, policy = self._at(values, selected)[1], self.policy
        steps = setup.training.steps
        training = replace(setup.training, validation_every=max(1, steps // TOLD))
        state = initial_progress(policy, training)
        summary(0, steps)
        state = train(
            setup.problem, state, training, setup.engines.train,
            [lambda progress: summary(progress.step, steps)],
        )  # fmt: skip
        before, _ = self._totals_worth(setup)
        after, result = self._totals_worth(setup, state.best)
        gain = statistics.of_shares(after - before)
        self._policies.append(state.best)
        return {
            "policy": len(self._policies) - 1,
            "value": result.value,
            "standard_error": result.standard_error,
            "gain": gain.value,
            "gain_error": gain.standard_error,
            "steps": state.step,
            "status": state.status,
        }

    @property
    def bounded(self) -> bool:
        """Whether the domain can compute an upper bound on the value of the best policy."""
        return not isinstance(self.study.relaxation, str)

    def bound_here(self, values: InputValues, selected: SelectedChoices = NONE) -> dict[str, Any]:
        """The lower and upper bound on the best value at these inputs, which limit the gain of the
        best policy.

        **Raises:** `CaseError` if the domain has no bound here, with the reason.
        """
        policy, (_, setup) = self.policy, self._at(values, selected)
        relaxation = self.rebuild(self.case_at(values, selected).case).relaxation
        if isinstance(relaxation, str):
            raise CaseError("the bound", "", None, relaxation)
        engine = setup.engines.evaluate
        return bound(
            setup.problem, policy, relaxation=relaxation(), paths=BOUND_PATHS, engine=engine
        ).row()

    def shares(self, values: InputValues, selected: SelectedChoices = NONE) -> np.ndarray:
        return self._totals_worth(self._at(values, selected)[1])[0]

    def explained(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> list[dict[str, Any]]:
        """The parts of the change with the run's policy; the effect of a policy trained on the page
        comes last."""
        adopted, self.policy = self.policy, self._policies[0]
        try:
            rows = super().explained(values, selected)
            before = self.shares(values, selected)
        finally:
            self.policy = adopted
        if self.is_adopted:
            rows.append(explained_by(["policy"], before, self.shares(values, selected)))
        return rows

    def _at(self, values: InputValues, selected: SelectedChoices = NONE) -> tuple[Study, Setup]:
        """The study of these choices, and the setup at these inputs, read from the case."""
        changed, moved = self.changed(values), self.case_at(values, selected)
        study, setup = self._variant(selected) if selected else (self.study, self.setup)
        if not changed:
            return study, setup
        assert study.setup_at is not None
        return study, study.setup_at(setup, moved.case)

    def _variant(self, selected: SelectedChoices) -> tuple[Study, Setup]:
        """The study of other choices, which is made and compiled once for each combination.

        **Raises:** `CaseError` if the run's policy does not fit it.
        """
        key = repr(sorted(selected.items()))
        if key not in self._variants:
            study = self.rebuild(self.case_at({}, selected).case)
            if study.setup is None or not _alike(study.setup().policy, self.setup.policy):
                message = (
                    "the run's policy makes different kinds of decisions; download this case and "
                    "solve it"
                )
                raise CaseError(", ".join(selected), "", None, message)
            self._variants[key] = study, study.setup()
        return self._variants[key]

    def _no_value(self, changed: InputValues, selected: SelectedChoices, invalid: int) -> CaseError:
        """The message that refuses numbers without a value; it names those inputs whose move,
        without the other moves, also gives no value."""
        wrong, policy = dict(changed), self.policy
        if 1 < len(changed) <= MAXIMUM:
            for name, new in changed.items():
                setup = self._at({name: new}, selected)[1]
                if not _too_many(setup, totals_of(setup, policy, self.counts.value)):
                    del wrong[name]
        source = self.setup.problem.sources.evaluation
        return no_value(
            wrong or changed, self.inputs_by_name, invalid, source.available(self.counts.value)
        )

    def _value(
        self, setup: Setup, rollout: Simulated, changed: InputValues, differs: bool
    ) -> dict[str, Any]:
        groups, result = _worth(setup, rollout.totals)
        if self._base is None:
            before = self.solution.policy
            self._base = self._totals_worth(self.setup, before)[0] if differs else groups
        change = statistics.of_shares(groups - self._base)
        first = {
            name: float(self.slopes[name] @ (new - self.inputs_by_name[name].value).ravel())
            for name, new in changed.items()
        }
        return {
            "value": result.value,
            "standard_error": result.standard_error,
            "paths": setup.problem.sources.evaluation.available(self.counts.value),
            "change": change.value if differs else 0.0,
            "change_error": change.standard_error if differs else 0.0,
            "predicted": sum(first.values()),
            "by_input": first,
        }

    def _totals_worth(self, setup: Setup, policy: Policy | None = None):
        """`_worth` of a policy, by default of the policy in use."""
        policy = policy or self.policy
        return _worth(setup, totals_of(setup, policy, self.counts.value))

    def _deltas(self, setup: Setup, rollout: Simulated, differs: bool) -> list[dict[str, Any]]:
        """The reported derivatives, with their intervals."""
        if differs and self._held is None:
            policy = self.solution.policy
            assert policy is not None
            before = simulate(self.setup, policy, self.counts)
            self._held = self._held_at(self.setup, before, policy)
        again = differs or self._held is None
        now = self._held_at(setup, rollout, self.policy) if again else self._held
        assert now is not None
        self._held = now if self._held is None else self._held
        sources = self.positions.sources
        inputs = movable(setup.problem.inputs_by_name, setup.case) if sources else None
        return derivatives(
            Deltas(self.solution.sensitivities, self._held, now),
            inputs or setup.problem.inputs_by_name,
            sources,
        )

    def _held_at(self, setup: Setup, rollout: Simulated, policy: Policy) -> dict[str, Estimate]:
        return sensitivities(
            setup.problem, policy, paths=self.counts.deltas,
            engine=setup.engines.evaluate, actions=rollout.actions,
            totals=None if rollout.actions is None else rollout.totals,
        ).held  # fmt: skip

    def _health(self, setup: Setup) -> dict[str, Any]:
        """The policy's distance from its optimum at these inputs, and at the inputs of training.

        It is measured by the norm of the gradient of the smooth value with respect to the policy,
        which is 0 at the optimum.
        """
        here, trained = self._slope(setup, self.policy), self.solution.policy
        if self._trained is None:
            assert trained is not None
            same = setup is self.setup and not self.is_adopted
            self._trained = here if same else self._slope(self.setup, trained)
        return {"gradient": here[0], "noise": here[1], "at_training": self._trained[0]}

    def _slope(self, setup: Setup, policy: Policy) -> tuple[float, float]:
        problem = setup.problem
        smooth = Smooth(np.float64(setup.training.temperature(setup.training.steps)))
        source = problem.sources.evaluation
        blocks = source.blocks(source.available(min(HEALTH_PATHS, self.counts.value)), 8)
        bound = setup.engines.evaluate.bind(problem, controls=False)
        path = DerivativePass(problem, bound, policy, smooth, held=False, inputs=False)
        return path.derivatives(blocks).policy.norm()


def _alike(one: Policy, other: Policy) -> bool:
    """Whether two policies have the same parts, the same action set and arrays of the same
    shapes."""
    shapes = [[np.shape(x) for x in jax.tree.leaves(item)] for item in (one, other)]
    return shapes[0] == shapes[1] and jax.tree.structure(one) == jax.tree.structure(other)


def fans(displayed: Mapping[str, Any], names: Mapping[str, str]) -> list[dict[str, Any]]:
    """Bands over time of every number of the state, the outputs and the actions, except those with
    an empty name."""
    results = []
    for kind in KINDS:
        for name, values in leaves(displayed[kind]).items():
            values = np.asarray(values, np.float64)
            values = values.reshape(*values.shape[:2], -1)
            if values.shape[2] > MAX_ENTRIES:
                continue
            for i in range(values.shape[2]):
                full = (name or kind) + (f".{i}" if values.shape[2] > 1 else "")
                if names.get(full) == "":
                    continue
                lines = {line: x.tolist() for line, x in bands(values[:, :, i]).items()}
                results.append({"name": full, "kind": kind, **lines})
    return results


def _too_many(setup: Setup, totals: Totals) -> int:
    """The number of non-finite paths if they leave no value, else 0."""
    objective = setup.problem.objective
    available = len(finite_totals(objective, totals)[objective.outputs[0]])
    return 0 if available else int(np.sum(~finite(totals, objective.outputs)))


def _worth(setup: Setup, totals: Totals) -> tuple[np.ndarray, Value]:
    """The parts of the value from independent groups of paths, and the value."""
    problem = setup.problem
    values = problem.objective, totals, problem.sources.evaluation
    controls = problem.simulator.control_variates()
    return value_of_groups(*values, controls), estimate(*values, controls)
