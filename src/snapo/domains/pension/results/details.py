"""All that the report of a pension run shows, as plain data (`details.json`)."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.problem.inputs import plain
from snapo.problem.scenarios import Scenarios
from snapo.solver import certificate
from snapo.solver.solution import Solution

from ..fund.swap_limits import limit_unit, notionals
from ..read.stress import read_shocks
from ..records.case import PensionCase
from . import balance, paths, stress
from .attribution import attribution
from .compare import equivalent
from .consistency import consistency
from .effects import effects
from .frontier import frontier
from .reconcile import Figures, Line, figures
from .variance import variance_by_source

if TYPE_CHECKING:
    from ..run import Problem

RECORD_PATHS = 4096
SLACK = 1e-9  # below a limit, of the assets: round-off


def details(
    problem: "Problem",
    solution: Solution,
    source: Scenarios,
    rivals: list[dict[str, Any]],
    lines: list[Line],
    progress: Callable[[str], None],
) -> dict[str, Any]:
    """All figures and tables of the report; money in the case's currency, shares as fractions."""
    case, engine = problem.case, problem.engines.evaluate
    count = min(RECORD_PATHS, problem.evaluation.paths)
    given = (case, problem.simulator, solution.policy, problem.schedule, source, count, engine)
    record = paths.Record(*given)
    found = figures(case, plain(problem.inputs))
    return {
        "title": case.title,
        "currency": case.currency,
        "valuation_date": case.valuation_date,
        "measure": "supplied" if case.scenarios is not None else case.measure,
        "years": case.steps * case.step,
        "step": case.step,
        "steps": case.steps,
        "notes": list(case.notes),
        "model": _model(problem),
        "held": list(case.held),
        "kinds": {each.kind: each.words for each in case.assets.classes},
        "assets": float(case.assets.amount.used()),
        "liability": found.liability,
        "funding": float(case.assets.amount.used()) / found.liability,
        "reconciliation": _reconciliation(problem, solution, found, lines),
        "by_year": paths.by_year(record),
        "policy_map": paths.policy_map(record),
        "mix": paths.mix(record),
        "limits": paths.limits_by_step(record, SLACK),
        **_today(problem, found, record),
        "objective": _objective(problem, solution),
        "sensitivities": effects(problem, solution),
        "policies": rivals,
        "attribution": attribution(problem, solution.policy, source),
        "spread": variance_by_source(problem, solution.policy, source),
        "frontier": frontier(problem, solution, source, progress),
        "certificate": _certificate(problem, solution, source),
        "seconds": dict(solution.seconds),
        "versions": dict(solution.versions),
        "seed": solution.seed,
        "engine": {"name": solution.engine, "reason": solution.reason},
        "paths": dict(solution.paths) | {"record": count},
    }


def profile_rows(found: dict[str, Any]) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `profile.csv`, one row per year: quantiles of the funding ratio."""
    years = found["by_year"]
    columns = {"year": years["years"], "underfunded": years["underfunded"]}
    columns |= {f"funding_{name}": values for name, values in years["funding"].items()}
    return tuple(columns), zip(*columns.values())


def _model(problem: "Problem") -> str:
    case = problem.case
    if case.scenarios is not None:
        return "Supplied scenarios: returns, inflation, wages and zero rates from a file."
    measure = {"P": "real-world (P)", "Q": "risk-neutral (Q)"}[case.measure]
    mean = f"means {case.assets.mean_kind}, of {case.assets.return_kind} returns"
    text = f"{case.rates.words}, fitted to the curve; {measure} scenarios"
    return f"{text}; {mean}." if case.measure == "P" else f"{text}; every class earns cash."


def _reconciliation(
    problem: "Problem", solution: Solution, found: Figures, lines: list[Line]
) -> dict[str, Any]:
    case = problem.case
    each = round(1 / case.step)
    flow = np.asarray(found.cash_flow)
    whole = len(flow) // each * each
    return {
        "lines": [line._asdict() for line in lines],
        "liability": found.liability,
        "duration": found.duration,
        "convexity": found.convexity,
        "inflation01": found.inflation01,
        "key_rate_durations": _key_rate_durations(case, found),
        "cash_flow": flow[:whole].reshape(-1, each).sum(1),
        "martingale": consistency(problem, solution.policy, found),
    }


def _key_rate_durations(case: PensionCase, found: Figures) -> dict[str, Any]:
    """Years at each node of the curve: minus d ln L / d quote; they add up to the duration."""
    if not found.liability:
        return {}
    years = -found.key_rate / balance.BASIS_POINT / found.liability
    return {"label": list(case.curve.rate.labels), "years": years}


def _today(problem: "Problem", found: Figures, record: paths.Record) -> dict[str, Any]:
    """Trades, key-rate ladder, collateral and stresses, with the policy's first decision."""
    case, first = problem.case, paths.first_decision(record)
    weights, places = first["weights"], first["overlay"]
    values = limit_unit(case)
    wanted = notionals(case, places, values)
    now = np.zeros(0) if case.overlay is None else case.overlay.notional.used()
    inputs = problem.inputs
    stresses = [
        balance.stressed(case, inputs, each, now)
        for each in stress.scenarios(case, read_shocks(case))
    ]
    return {
        "trades": balance.trades(case, weights, places, values),
        "ladder": balance.ladder(case, inputs, found, now),
        "ladder_after": balance.ladder(_rebalanced(case, weights), inputs, found, wanted),
        "collateral": {
            "now": balance.headroom(case, case.assets.weight.used(), now),
            "after": balance.headroom(case, weights, wanted),
        },
        "stresses": stresses,
    }


def _rebalanced(case, weights: np.ndarray):
    given = replace(case.assets.weight, values=np.asarray(weights, np.float64))
    return replace(case, assets=replace(case.assets, weight=given))


def _objective(problem: "Problem", solution: Solution) -> dict[str, Any]:
    terms = [
        {"weight": t.weight, "output": t.output, "kind": t.objective.kind}
        for t in problem.case.objective
    ]
    found: dict[str, Any] = {"terms": terms, "value": solution.value}
    known = equivalent(problem.objective, solution.value)
    if known is not None:
        found |= {"equivalent": known.ratio, "slope": known.slope}
        found["equivalent_error"] = known.slope * solution.standard_error
        found["aversion"] = problem.objective.utility.aversion  # pyright: ignore
    return found


def _certificate(problem: "Problem", solution: Solution, source: Scenarios) -> dict[str, Any]:
    """The adjoint against bumps, limits kept, the smoothing gap."""
    engine = problem.engines.evaluate
    available = problem.evaluation.paths
    given = (problem.simulator, certificate.nudged(problem.inputs), solution.policy)
    bumps = certificate.bump_check(
        *given, problem.objective, source, min(256, available), engine=engine
    )
    limits = certificate.feasibility(
        problem.simulator, problem.schedule, solution.policy, source, min(4096, available), engine
    )
    return {
        "bump_check": [bump.row() for bump in bumps],
        "feasibility": [limit.row(SLACK) for limit in limits],
        "smoothing_gap": solution.smoothing_gap,
        "policy_gradient_norm": solution.policy_gradient_norm,
    }
