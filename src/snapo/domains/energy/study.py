"""The study of a contract: the parts of a run, and the headline of its result."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from snapo.problem.problem import Problem
from snapo.report.drawing import local_times_of
from snapo.report.quantity import readable
from snapo.study.chapters.bound import BOUND
from snapo.study.chapters.certificate import CERTIFICATE
from snapo.study.chapters.distribution import DISTRIBUTION
from snapo.study.chapters.profile import MAX_ENTRIES, profile
from snapo.study.chapters.sensitivities import MOVES
from snapo.study.domain import Options
from snapo.study.study import Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from ..gas_storage.chapters.vega import volatilities
from .chapters.ladder import METHODS
from .chapters.products import GAMMA, PRODUCT_DELTAS, VEGA, check_gamma
from .chapters.reference import INTRINSIC, REFERENCE, ExactValue
from .chapters.values import VALUES
from .core.contract import ContractLayout
from .core.feasibility import check_limits
from .core.intraday import TRADED
from .core.simulator import simulator_of
from .methods.grid import check_nodes, grid_of
from .methods.hindsight import EnergyRelaxation
from .read.case import KINDS, EnergyCase
from .setup import bare_problem, make_setup, setup_at


def study(case: EnergyCase, options: Options) -> Study:
    """All parts of a run.

    **Raises:** `CaseError` if the limits of the contract cannot be met, or a requested gamma is not
    available.
    """
    if options.gamma:
        check_gamma(case)
    ready, problem = _Prepared(case, options.engine), bare_problem(case)
    check_limits(case, problem.schedule)
    check_nodes(case, problem.schedule)
    relaxation = _relaxation(ready, problem)
    parts = [INTRINSIC.part, TRAINING, MOVES.part, DISTRIBUTION.part,
             profile(together=KINDS[case.kind].steps).part,
             CERTIFICATE.part]  # fmt: skip
    parts += [] if case.products is None else [PRODUCT_DELTAS.part]
    parts += [VEGA.part] if volatilities(problem) else []
    parts += [BOUND.part] if callable(relaxation) else []
    parts += [REFERENCE.part] if options.reference else []
    parts += [METHODS.part] if options.ladder else []
    parts += [GAMMA.part] if options.gamma else []
    return Study(
        case.kind,
        _about(case),
        (*parts, VALUES.part),
        _result,
        lambda: ready.setup,
        relaxation,
        setup_at=setup_at,
        inputs=lambda other: other.inputs(),
        meanwhile=relaxation if callable(relaxation) else None,
    )


def _relaxation(prepared: "_Prepared", problem: Problem) -> Callable[[], EnergyRelaxation] | str:
    kind = prepared.case.objective.kind
    if kind != "mean":
        return f'only a mean has an upper bound, but the objective is "{kind}"'
    if not grid_of(simulator_of(problem).layout, problem.schedule).exact:
        return (
            "its volumes have no common divisor with few enough nodes, so that upper bounds "
            "would be too low"
        )
    return lambda: prepared.relaxation


class _Prepared:
    """The prepared case; it is prepared once, when the first part needs it."""

    def __init__(self, case: EnergyCase, engine: Any):
        self.case, self.engine = case, engine

    @cached_property
    def setup(self) -> Setup:
        return make_setup(self.case, self.engine)

    @cached_property
    def relaxation(self) -> EnergyRelaxation:
        return EnergyRelaxation(self.setup.problem)


def _about(case: EnergyCase) -> dict[str, Any]:
    """The description of the case before any work: title, units, dates and notes."""
    layout, money = case.contract.layout, case.currency
    unit = money if case.objective.keeps_unit else ""
    units = {flow.name: flow.unit for flow in layout.flows}
    units |= dict.fromkeys(layout.reported, "1")
    units |= {layout.levels[-1].name: layout.flows[0].unit} if layout.sums else {}
    units |= {} if case.scheduled is None else {TRADED: case.volume_unit}
    hourly, together = KINDS[case.kind].hourly, KINDS[case.kind].steps
    days = [day.isoformat() for day in case.days[::together]]
    times = case.market.forward_curve.labels if hourly else days
    return {
        "title": case.title,
        "unit": unit,
        "value_unit": unit,
        "currency": money,
        "volume_unit": case.volume_unit,
        "names": _names(layout),
        "units": units | {"cash_flow": money, "shortfall": money, "levels": case.volume_unit},
        "valuation_date": case.valuation_date.isoformat(),
        "start": case.days[0].isoformat(),
        "step": "hour" if hourly else "day",
        "local_times": local_times_of(times, 24 if hourly else 1),
        "horizon": len(case.days) // together,
        "model": case.model.describe(),
        "objective": f"{case.objective.kind} of the discounted cash flow",
        "objective_output": "cash_flow",
        "notes": list(case.notes),
        "forward": np.asarray(case.market.forward_curve.used()[::together]),
    }


def _names(layout: ContractLayout) -> dict[str, str]:
    """{state, decision or output: its name in a report}. The name is empty if it is not shown:
    factors of the price model, the mode of a contract with only one, shares of flows, and the
    control variate."""

    def numbered(key: str, names: Sequence[str]) -> dict[str, str]:
        keys = [key] if len(names) == 1 else [f"{key}.{i}" for i in range(len(names))]
        return dict(zip(keys, names))

    modes = [f"In mode: {name}" for name in layout.modes] if layout.modes[1:] else [""]
    decisions = [""] * len(layout.pairs)  # the flows themselves are outputs
    decisions += [f"Decision: {layout.moves[m].name}" for m in layout.choices]
    levels = [readable(level.name) for level in layout.levels]
    if layout.sums:  # an output
        levels[-1] = ""
    price = {name: "" for name in ("price", *(f"price.{i}" for i in range(8)))}
    return (
        {**numbered("levels", levels), **numbered("mode", modes), **numbered("action", decisions)}
        | price
        | {"value_surprise": ""}
        | ({"mode": ""} if len(modes) > MAX_ENTRIES else {})
        | ({"action": ""} if len(decisions) > MAX_ENTRIES else {})
    )


def _result(run: StudyRun) -> dict[str, Any]:
    plan, reference, bounds = INTRINSIC.of(run), REFERENCE.of(run) or ExactValue(), BOUND.of(run)
    exact, error = reference.dynamic_programming, reference.dynamic_programming_error
    references = {
        "intrinsic": plan.intrinsic if plan else None,
        "dynamic_programming": exact,
        "upper_bound": bounds.upper.value if bounds else None,
    }
    errors = {} if error is None else {"reference_errors": {"dynamic_programming": error}}
    gamma = {GAMMA.key: run.get(GAMMA.key)} if GAMMA.of(run) else {}
    return trained(run, references, exact=exact) | {BOUND.key: run.get(BOUND.key)} | errors | gamma
