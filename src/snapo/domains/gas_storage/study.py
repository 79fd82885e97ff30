"""The study of a storage case: the parts of a run, and the headline of its result."""

from dataclasses import asdict
from functools import cached_property
from typing import Any

from snapo.problem.problem import Problem
from snapo.study.chapters.bound import BOUND
from snapo.study.domain import Options
from snapo.study.study import Part, Setup, Study, StudyRun
from snapo.study.training import TRAINING, trained

from .bounds.relaxation import StoreRelaxation
from .bounds.value_iteration import FittedValue
from .chapters.certificate import CERTIFICATE
from .chapters.deltas import DELTAS
from .chapters.gamma import GAMMA
from .chapters.hedge import HEDGE
from .chapters.ladder import METHODS
from .chapters.position import POSITION
from .chapters.products import PRODUCT_DELTAS
from .chapters.quotes import QUOTE_DELTAS
from .chapters.risk import SHADOW_PRICES
from .chapters.run import InputEntry
from .chapters.today import today
from .chapters.value import INTRINSIC, REFERENCE, VALUES, Reference, intrinsic_chapter
from .chapters.vega import VEGA, volatilities
from .contract.records import StorageCase
from .contract.terms import fixed_costs_value, value_without_decisions
from .setup import bare_problem, fitted_value, make_setup, setup_at

KIND = "gas-storage"


def study(case: StorageCase, options: Options) -> Study:
    """All parts of a run; for a contract without a decision left, only its value."""
    if not case.days:
        return Study(KIND, _about(case), (Part("value", _expired(case)),), _expired_result)
    ready, bare = _Prepared(case, options.engine), bare_problem(case)
    of_quotes = () if case.quotes is None else (QUOTE_DELTAS,)
    of_products = () if case.products is None else (PRODUCT_DELTAS,)
    of_prices = (VEGA,) if volatilities(bare) else ()
    optional = (*of_quotes, *of_products, *of_prices)
    chapters = (POSITION, DELTAS, *optional, SHADOW_PRICES, CERTIFICATE)
    parts = [intrinsic_chapter(bare, case).part, TRAINING, *(x.part for x in chapters)]
    relaxation = _relaxation(ready)
    if callable(relaxation):
        parts.append(BOUND.part)
    if options.reference:
        parts.append(REFERENCE.part)
    if options.ladder:
        parts.append(METHODS.part)
    if options.hedge:
        parts.append(HEDGE.part)
    if options.gamma:
        parts.append(GAMMA.part)
    parts.append(VALUES.part)
    return Study(
        KIND,
        _about(case, bare),
        tuple(parts),
        _result,
        lambda: ready.setup,
        relaxation,
        setup_at=setup_at,
        today=today,  # pyright: ignore[reportArgumentType]
        meanwhile=relaxation if callable(relaxation) else None,
    )


def _relaxation(prepared: "_Prepared"):
    """The inner problem of the upper bound; or the reason why the run has no upper bound."""
    kind = prepared.case.objective.kind
    if kind != "mean":
        return f'only a mean has an upper bound, but the objective is "{kind}"'
    return lambda: prepared.relaxation


class _Prepared:
    """The prepared case; it is prepared once, when the first part needs it."""

    def __init__(self, case: StorageCase, engine: str):
        self.case, self.engine = case, engine

    @cached_property
    def setup(self) -> Setup:
        return make_setup(self.case, self.engine, self.fitted_value)

    @cached_property
    def relaxation(self) -> StoreRelaxation:
        return StoreRelaxation(self.setup.problem)

    @cached_property
    def fitted_value(self) -> FittedValue | None:
        """The value function for the value table and the control variate."""
        return fitted_value(bare_problem(self.case))


def _about(case: StorageCase, problem: Problem | None = None) -> dict[str, Any]:
    """The description of the case before any work: title, units, dates, notes, curve, and the
    metadata of the inputs."""
    notes = ["No decision day is left."] if problem is None else []
    about = {
        "title": case.title,
        "currency": case.currency,
        "volume_unit": case.volume_unit,
        "valuation_date": case.valuation_date.isoformat(),
        "start": case.start.isoformat(),
        "end": case.end.isoformat(),
        "days": [day.isoformat() for day in case.days],
        "model": case.model.describe(),
        "objective": case.objective.kind,
        "value_unit": case.currency if case.objective.keeps_unit else "",
        "units": dict.fromkeys(("inventory", "injection", "withdrawal"), case.volume_unit)
        | dict.fromkeys(("cash_flow", "costs"), case.currency),
        "names": {
            "action.0": "injection, as a share of the possible flow",
            "action.1": "withdrawal, as a share of the possible flow",
            "value_surprise": "innovation of the value",
        },
        "notes": [*notes, *case.notes],
        "fixed_costs": fixed_costs_value(case),
    }
    if problem is None:
        return about
    inputs = {
        name: asdict(
            InputEntry(
                words=item.meaning,
                group=item.group,
                unit=item.unit,
                move=item.move,
                trade_unit=item.display_unit,
                trade_factor=item.display_factor,
            )
        )
        for name, item in problem.inputs_by_name.items()
    }
    forward = case.market.forward_curve.used()[: len(case.days)]
    return about | {"forward": forward, "inputs": inputs}


def _result(run: StudyRun) -> dict[str, Any]:
    plan, reference = INTRINSIC.of(run), REFERENCE.of(run) or Reference()
    bounds = BOUND.of(run)
    exact, error = reference.dynamic_programming, reference.dynamic_programming_error
    references = {
        "intrinsic": plan.value if plan else None,
        "dynamic_programming": exact,
        "upper_bound": bounds.upper.value if bounds else None,
    }
    errors = {} if error is None else {"reference_errors": {"dynamic_programming": error}}
    gamma = {GAMMA.key: run.get(GAMMA.key)} if GAMMA.of(run) else {}
    return trained(run, references, exact=exact) | {BOUND.key: run.get(BOUND.key)} | errors | gamma


def _expired(case: StorageCase):
    """The part of a case without a decision left: it has a value, and nothing to train."""
    return lambda run: {"value_at_the_end": value_without_decisions(case)}


def _expired_result(run: StudyRun) -> dict[str, Any]:
    value = run.get("value_at_the_end")
    return {
        "value": value,
        "standard_error": 0.0,
        "references": {"intrinsic": value, "dynamic_programming": value},
        "status": "ok",
    }
