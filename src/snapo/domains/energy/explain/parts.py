"""The parts of a change of value of any contract of the core; see `gas_storage.explain.chain`.

The steps between the two dates are those that the policy plans at forward prices.

A contract supplies only the keys of a case that begins in another state (`EnergyContract.keys_at`).
"""

import copy
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import numbers_in
from snapo.problem.carry.save import PolicyFileError
from snapo.problem.carry.save import load as load_policy
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import Exact
from snapo.solver import statistics
from snapo.solver.solution import POLICY as POLICY_FILE
from snapo.study.study import ProgressCallback, Setup

from ...gas_storage.contract.schedule import Discount
from ...gas_storage.explain import DECISIONS, NOTES
from ...gas_storage.explain.chain import (
    ChangeChain,
    CurveChange,
    Started,
    delivery_periods,
    with_numbers,
)
from ...gas_storage.explain.change import ExplainedChange
from ...gas_storage.explain.curve import DeliveryPeriod
from ...gas_storage.explain.runs import FIXED, ValuedRun, check_pair
from ...gas_storage.prices.index import IndexedPrices
from ...gas_storage.read.tables import FORWARD
from ..core.contract import StepPrices
from ..core.policy import UnitValuePolicy, reordered
from ..core.simulator import EnergySimulator, simulator_of
from ..read.case import EnergyCase, read_case
from ..setup import OUTPUT, bare_problem, make_setup, rebuilt, setup_at
from . import NOT_AS_PLANNED

ROUNDED = 9  # decimals of a planned level: a limit is not passed by rounding


class PlannedSteps(NamedTuple):
    """The state after the planned steps (levels by name, and the mode), and the cash of the steps,
    discounted to the later date."""

    levels: dict[str, float]
    mode: str
    cash: float


class AtForwardPrices(EnergySimulator):
    """A contract at today's forward prices, and at today's expectation of the index."""

    def prices(self, constants, now, state) -> StepPrices:
        if not self.layout.indexed:
            return StepPrices(now.forward)
        return StepPrices(now.forward, now.price.index.expected())


def planned_steps(
    problem: Problem, policy: UnitValuePolicy, count: int, elapsed: int
) -> PlannedSteps:
    """The planned first steps of a contract, one or more; `elapsed`: the days to the later
    valuation date."""
    simulator = simulator_of(problem)
    numbers = {x.name: getattr(simulator, x.name) for x in fields(EnergySimulator)}
    numbers |= {name: _from_later(numbers[name], elapsed) for name in ("paid", "settled")}
    planned = AtForwardPrices(**numbers)
    with jax.enable_x64(True):
        inputs = {name: np.asarray(x.value) for name, x in problem.inputs_by_name.items()}
        schedule = jax.tree.map(np.asarray, _prepared(planned, inputs))
        rows = jax.tree.map(lambda leaf: leaf[:count], schedule.steps)
        light = replace(planned.on_paths(), time=np.zeros(1), first=0)
        levels, mode, cash = _planned(policy, light, schedule.constants, rows)
    layout = simulator.layout
    name = layout.modes[int(np.argmax(np.asarray(mode)))]
    return PlannedSteps(_named(layout, np.asarray(levels)), name, float(cash))


def state_of(problem: Problem) -> PlannedSteps:
    """The state in which a contract begins."""
    layout = simulator_of(problem).layout
    start = np.asarray(problem.schedule.constants.start)
    return PlannedSteps(_named(layout, start), layout.modes[0], 0.0)


def _named(layout: Any, levels: np.ndarray) -> dict[str, float]:
    numbers = [round(float(x), ROUNDED) + 0.0 for x in levels]
    return {level.name: x for level, x in zip(layout.levels, numbers, strict=True)}


def _from_later(discount: Discount, elapsed: int) -> Discount:
    """Discount factors to a later date; a payment before that date counts in full."""
    return replace(discount, day=np.maximum(discount.day - elapsed, 0.0))


@compiled_sooner
def _prepared(simulator: EnergySimulator, inputs: dict[str, Any]):
    return simulator.prepare(inputs)


@compiled_sooner
def _planned(policy, simulator: EnergySimulator, constants, rows):
    process = simulator.process
    noise = jnp.zeros(process.noise_size)

    def step(carry, now):
        state, cash = carry
        state = state._replace(price=process.state_at(constants.price, now.price, now.forward))
        action = policy(simulator.observe(constants, now, state), Exact())
        after, outputs = simulator.step(constants, now, state, action, noise, Exact())
        return (after, cash + outputs[OUTPUT]), None

    first = jax.tree.map(lambda leaf: leaf[0], rows)
    before = jnp.zeros(max(process.initial_noise_size, 1))
    state = simulator.initial(constants, before)
    state = state._replace(price=process.state_at(constants.price, first.price, first.forward))
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), state)
    (state, cash), _ = jax.lax.scan(step, (state, jnp.zeros(())), rows)
    return state.levels, state.mode, cash


def explained_change(
    first: ValuedRun,
    second: ValuedRun,
    progress: ProgressCallback,
    flows: Any = None,
    cash: float | None = None,
) -> ExplainedChange:
    """The parts of the change of value; `cash`: the actual cash flow between the two dates.

    **Raises:** `CaseError` if the second run cannot follow the first one.
    """
    if flows is not None:
        message = "--flows is for a gas store; use --cash for the cash flow of this contract"
        raise CaseError("--flows", "", None, message)
    check_pair(first, second)
    for run in (first, second):
        if run.case.scheduled is not None:
            raise CaseError(str(run.file), "contract.auction", None, FIXED)
    return _ContractChain(first, second, progress, cash).result()


class _ContractChain(ChangeChain):
    """Revaluations from the first run of a contract to the second one."""

    at = staticmethod(setup_at)  # pyright: ignore[reportAssignmentType]

    def __init__(
        self, first: ValuedRun, second: ValuedRun, progress: ProgressCallback, cash: float | None
    ):
        self.cash = cash
        super().__init__(first, second, progress, make_setup(second.case, second.engine))

    def policies(self) -> tuple[Policy, Policy]:
        return _policy(self.first, self.setup), _policy(self.second, self.setup)

    def shares(self, setup: Setup, policy: Policy) -> np.ndarray:
        assert isinstance(policy, UnitValuePolicy)
        return super().shares(setup, _in_order(policy, simulator_of(setup.problem).layout, self))

    def started(self) -> Started:
        first, other = self.first, self.second.case
        one, count = first.case, len(first.case.days) - len(other.days)
        elapsed = (other.valuation_date - one.valuation_date).days
        actual = state_of(bare_problem(other))
        planned, index = state_of(bare_problem(one)), None
        if count:
            problem, policy = rebuilt(bare_problem(one)), self.policy
            assert isinstance(policy, UnitValuePolicy)
            policy = _in_order(policy, simulator_of(problem).layout, self)
            planned = planned_steps(problem, policy, count, elapsed)
            if isinstance(other.model, IndexedPrices) and other.model.fixing is not None:
                index = float(problem.schedule.steps.price.index.expected()[count])
        case = self._on_date(planned, index)
        setup = self.setup_of(case, self.setup)
        later = other.valuation_date > one.valuation_date
        if later:
            start, setup = self.time(setup, count, planned.cash)
        else:
            start = self.shares(setup, self.policy)
        cash, notes = planned.cash, ()
        if self.cash is not None:
            if not count:
                message = "there is no decision between the two valuation dates"
                raise CaseError("--cash", "", self.cash, message)
            cash = self.cash
        differs = not _same_state(planned, actual)
        if differs:
            setup = self.setup_of(self._on_date(actual, index), setup)
            now = self.shares(setup, self.policy)
            step = statistics.of_shares(now - start)
            more = cash - planned.cash
            self.row(DECISIONS, step.value + more, step.standard_error, NOTES[DECISIONS])
            notes = (NOT_AS_PLANNED,) if count and self.cash is None else ()
        elif cash != planned.cash:
            self.row(DECISIONS, cash - planned.cash, None, NOTES[DECISIONS])
        return Started(np.zeros(0) if later else start, setup, cash, (), notes)

    def simulator_of(self, case: EnergyCase) -> Any:
        return bare_problem(case).simulator

    def moved(self, case: EnergyCase) -> tuple[EnergyCase, list[CurveChange]]:
        new = curves_of(self.second.case)
        old = curves_of(case)
        if list(old) != list(new):
            message = (
                f"{self.first.folder} has other curves: both runs must have curves of the "
                "same markets"
            )
            raise CaseError(str(self.second.file), "market", ", ".join(new), message)
        changes = [
            CurveChange(
                name,
                name.removesuffix("_curve") if len(new) > 1 else "",
                old[name].used(),
                new[name].used(),
            )
            for name in new
        ]
        return with_curves(case, new), changes

    def terms(self, case: EnergyCase) -> tuple[Any, ...]:
        return case.contract, case.market, case.day, case.time

    def with_model(self, case: EnergyCase, model: Any) -> EnergyCase:
        # The fixing of an index is a number of the contract too.
        numbers = {x.name: x for x in numbers_in((model,))}
        return replace(case, model=model, contract=with_numbers(case.contract, numbers))

    def periods(self) -> Sequence[DeliveryPeriod]:
        case = self.second.case
        # The index of a month is a mean of its prices: months are then the periods.
        spot = not isinstance(case.model, IndexedPrices)
        return delivery_periods(case.days, case.products if spot else None)

    def _on_date(self, state: PlannedSteps, index: float | None) -> EnergyCase:
        """The case of the first run on the valuation date of the second run, in this state.

        Its prices, model, rates and terms are those of the first run, step by step; the settings of
        training and evaluation are those of the second run.
        """
        first, other = self.first, self.second.case
        data: Any = copy.deepcopy(dict(first.data))
        data["market"] = data["market"] | {"valuation_date": other.valuation_date}
        try:
            keys = first.case.contract.keys_at(state.levels, state.mode, index)
        except ValueError as error:
            date = other.valuation_date
            message = f"on {date} the plan of {first.folder} leads to an invalid initial state"
            raise CaseError(str(first.file), "contract", None, f"{message}: {error}") from None
        for name, value in keys.items():
            *tables, key = name.split(".")
            table = data["contract"]
            for item in tables:
                table = table[item]
            table[key] = value
        case = read_case(first.file, data)
        old, own, target = curves_of(first.case), curves_of(case), curves_of(other)
        later = {
            name: _like(target.get(name, curve), old[name].used()[-len(curve.used()) :])
            for name, curve in own.items()
        }
        settings = {name: getattr(other, name) for name in ("training", "evaluation", "objective")}
        return replace(with_curves(case, later), **settings)


def curves_of(case: EnergyCase) -> dict[str, CaseInput]:
    """{name: forward prices} of each market."""
    numbers = numbers_in((case.market, case.model))
    return {x.name: x for x in numbers if x.group == FORWARD.group}


def with_curves(case: EnergyCase, curves: dict[str, CaseInput]) -> EnergyCase:
    """The case in which the forward prices with these names are replaced."""
    market, model = (with_numbers(x, curves) for x in (case.market, case.model))
    return replace(case, market=market, model=model)


def _like(curve: CaseInput, prices: np.ndarray) -> CaseInput:
    """A record of prices [T]. It has the form of `curve` if the numbers of `curve` can represent
    them; otherwise it has one number for each step."""
    values = np.array(curve.values, np.float64)
    values[curve.index] = prices
    if np.array_equal(values[curve.index], prices):
        return replace(curve, values=values, positions=())
    steps = np.arange(len(prices))
    labels = tuple(str(t) for t in steps)
    return replace(curve, values=prices, index=steps, labels=labels, positions=(), starts=None)


def _same_state(one: PlannedSteps, other: PlannedSteps) -> bool:
    levels = [list(x.levels.values()) for x in (one, other)]
    return one.mode == other.mode and np.allclose(*levels, rtol=1e-9, atol=1e-9)


def _policy(run: ValuedRun, setup: Setup) -> Policy:
    """The trained policy of a run.

    **Raises:** `CaseError` if the run has no policy, or one that does not fit `setup`.
    """
    features, layout = setup.problem.features, run.case.contract.layout
    like = UnitValuePolicy(layout, features, key=jax.random.key(0))
    try:
        return load_policy(run.folder / POLICY_FILE, Policy, like)
    except (PolicyFileError, OSError) as error:
        message = "this policy is for a case with other levels or decisions"
        file = str(run.folder / POLICY_FILE)
        raise CaseError(file, "", None, f"{message} ({error})") from None


def _in_order(policy: UnitValuePolicy, layout: Any, chain: _ContractChain) -> UnitValuePolicy:
    try:
        return reordered(policy, layout)
    except ValueError as error:
        message = f"the policies of {chain.first.folder} and this run do not fit: {error}"
        raise CaseError(str(chain.second.file), "contract", None, message) from None
