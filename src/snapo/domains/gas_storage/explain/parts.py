"""The parts of a change of value of a gas store; see `chain.py`."""

import datetime
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from snapo.case.error import CaseError, counted
from snapo.solver import statistics
from snapo.study.study import ProgressCallback

from ..contract.records import StorageCase
from ..history.backtest import trained_policy
from ..policy.network import StoragePolicy
from ..setup import bare_problem, fitted_value, make_setup, rebuilt, setup_at
from . import DECISIONS, NOTES, SPOT
from .chain import ChangeChain, CurveChange, Started
from .change import ExplainedChange
from .flows import PassedDays, TakenFlow, passed_days
from .runs import ValuedRun, check_pair, on_date_of, with_curve


def explained_change(
    first: ValuedRun,
    second: ValuedRun,
    progress: ProgressCallback,
    flows: Mapping[datetime.date, TakenFlow] | None = None,
    cash: float | None = None,
) -> ExplainedChange:
    """The parts of the change of value; `flows`: the actual flows on the days between the two
    dates.

    **Raises:** `CaseError` if the second run cannot follow the first one.
    """
    if cash is not None:
        raise CaseError(
            "--cash",
            "",
            cash,
            "--cash is not for a gas store: use --flows, from which its cash flow is computed",
        )
    check_pair(first, second)
    return _StoreChain(first, second, progress, flows).result()


class _StoreChain(ChangeChain):
    """Revaluations from the first run of a store to the second one."""

    at = staticmethod(setup_at)  # pyright: ignore[reportAssignmentType]

    def __init__(
        self,
        first: ValuedRun,
        second: ValuedRun,
        progress: ProgressCallback,
        flows: Mapping[datetime.date, TakenFlow] | None,
    ):
        case, self.flows = second.case, flows
        setup = make_setup(case, second.engine, fitted_value(bare_problem(case)))
        super().__init__(first, second, progress, setup)

    def policies(self) -> tuple[StoragePolicy, StoragePolicy]:
        like = self.setup.policy
        assert isinstance(like, StoragePolicy)
        return trained_policy(self.first.folder, like), trained_policy(self.second.folder, like)

    def _passed(self) -> PassedDays:
        """The days of the first run before those of the second run."""
        one, other = self.first.case, self.second.case
        count = len(one.days) - len(other.days)
        elapsed = (other.valuation_date - one.valuation_date).days
        inventory = float(other.contract.inventory.used())
        problem = rebuilt(bare_problem(one)) if count else bare_problem(one)
        numbers = count, inventory, elapsed
        policy = self.policy
        assert isinstance(policy, StoragePolicy)
        return passed_days(one, problem, policy, *numbers, self.flows)

    def started(self) -> Started:
        first, other, passed = self.first, self.second.case, self._passed()
        inventory = float(other.contract.inventory.used())
        later = other.valuation_date > first.case.valuation_date
        planned = on_date_of(first, self.second, passed.planned_inventory)
        setup = self.setup_of(planned, self.setup)
        if later:
            start, setup = self.time(setup, len(passed.flows), passed.planned_cash)
        else:
            start = self.shares(setup, self.policy)
        if any(flow.taken != flow.planned for flow in passed.flows) or not np.isclose(
            passed.planned_inventory, inventory, rtol=1e-9
        ):
            setup = self.setup_of(on_date_of(first, self.second, inventory), setup)
            now = self.shares(setup, self.policy)
            step = statistics.of_shares(now - start)
            more = passed.forward_cash - passed.planned_cash
            self.row(DECISIONS, step.value + more, step.standard_error, NOTES[DECISIONS])
        if passed.cash != passed.forward_cash:
            self.row(SPOT, passed.cash - passed.forward_cash, None, NOTES[SPOT])
        notes = () if self.flows else tuple(_notes(passed))
        start = np.zeros(0) if later else start
        return Started(start, setup, passed.cash, passed.flows, notes)

    def simulator_of(self, case: StorageCase) -> Any:
        return bare_problem(case).simulator

    def moved(self, case: StorageCase) -> tuple[StorageCase, list[CurveChange]]:
        old, new = case.market.forward_curve, self.second.case.market.forward_curve
        change = CurveChange(new.name, "", old.used(), new.used())
        return with_curve(case, new.used()), [change]

    def terms(self, case: StorageCase) -> tuple[Any, ...]:
        return case.contract, case.market, case.day, case.end_day


def _notes(passed: PassedDays) -> Iterator[str]:
    if len(passed.flows) > 1 and any(x.taken != x.planned for x in passed.flows):
        yield (
            f"{counted(len(passed.flows), 'day')} passed: the difference from the planned flows is "
            "spread evenly over these days, at the forward prices of the first run; name a file "
            "with the actual flows with --flows"
        )
    elif len(passed.flows) > 1:
        count = len(passed.flows)
        yield (
            f"{counted(count, 'day')} passed: the flows on these days are valued at the forward "
            "prices; name a file with other prices with --flows"
        )
