"""Everything that the report of a pension run shows, as plain data (`details.json`)."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import certificate
from ...adjoint import prepare
from ...evaluate import path_totals
from ...inputs import plain
from ...scenarios import Pseudo, Scenarios
from ...smooth import Exact
from ...solution import Solution
from ...train import EVALUATE_STREAM
from . import balance, paths, stress, units
from .attribution import attribution
from .cells import empty
from .compare import equivalent
from .reconcile import Figures, Line, figures
from .simulator import PensionSimulator

if TYPE_CHECKING:
    from .run import Problem

RECORD_PATHS, MARTINGALE_PATHS = 4096, 16384
SLACK = 1e-9  # below a limit: round-off
ROUND_OFF = 1e-12  # of a value that does not vary over paths


def details(
    problem: "Problem",
    solution: Solution,
    source: Scenarios,
    rivals: list[dict[str, Any]],
    lines: list[Line],
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
        "assets": float(case.assets.amount.used()),
        "liability": found.liability,
        "funding": float(case.assets.amount.used()) / found.liability,
        "reconciliation": _reconciliation(problem, solution, found, lines),
        "by_year": paths.by_year(record),
        "policy_map": paths.policy_map(record),
        "mix": paths.mix(record),
        "limits": paths.limits_by_month(record),
        **_today(problem, found, record),
        "objective": _objective(problem, solution),
        "sensitivities": _sensitivities(problem, solution),
        "policies": rivals,
        "attribution": attribution(problem, solution.policy, source),
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
    rates = {"hull-white": "Hull-White, one factor", "g2++": "G2++, two factors"}
    measure = {"P": "real-world (P)", "Q": "risk-neutral (Q)"}[case.measure]
    mean = f"means {case.assets.mean_kind}, of {case.assets.return_kind} returns"
    text = f"{rates[case.rates.kind]}, fitted to the curve; {measure} scenarios"
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
        "cash_flow": flow[:whole].reshape(-1, each).sum(1),
        "martingale": _martingale(problem, solution, found),
    }


def _martingale(problem: "Problem", solution: Solution, found: Figures) -> list[dict[str, Any]]:
    """Risk-neutral tests on fresh paths: what discounted values should be, and what they are.

    They are made under "Q" whatever the measure of the case, with the trained policy, and without
    the cost of hedging currencies, which nobody receives. Costs count where they are paid. None
    where scenarios are supplied; appraised values and bases with a spread are no prices.
    """
    case = problem.case
    if case.scenarios is not None:
        return []
    free = replace(case.currencies, hedge_cost=empty("hedge_cost", (len(case.currencies.names),)))
    neutral = replace(case, measure="Q", currencies=free)
    simulator = PensionSimulator(neutral)  # pyright: ignore[reportCallIssue]
    schedule = prepare(simulator, problem.inputs)
    source = Pseudo(problem.training.seed, stream=(EVALUATE_STREAM << 32) + 3)
    given = (problem.engines.evaluate, simulator, solution.policy, schedule, source)
    totals = path_totals(*given, MARTINGALE_PATHS, Exact())
    years = np.array([case.steps * case.step])
    horizon = float(np.exp(_log_bond(problem, years))[0])
    tests = [("Discount factor at the horizon", totals["discount"], horizon)]
    if not case.assets.smoothed.size:
        paid = totals["pv_benefit"] + totals["pv_expenses"] + totals["pv_cost"]
        left = totals["pv_assets"] + paid - totals["pv_contribution"]
        tests.append(("Assets: what they leave and pay", left, float(case.assets.amount.used())))
    plain_basis = case.liability.basis == "risk-free" and case.liability.future_indexation == "none"
    if plain_basis and case.lee_carter is None:
        added = totals["pv_indexation"] + totals["pv_accrual"]
        left = totals["pv_liability"] + totals["pv_benefit"] - added
        tests.append(("Liability: what it leaves and pays", left, found.liability))
    return [_tested(name, values, expected, source) for name, values, expected in tests]


def _tested(name: str, values: np.ndarray, expected: float, source: Scenarios) -> dict[str, Any]:
    """One line: the mean over independent groups of paths against what it should be."""
    groups = source.groups(np.arange(values.size))
    means = np.bincount(groups, values) / np.bincount(groups)
    mean, error = float(means.mean()), float(means.std(ddof=1) / np.sqrt(means.size))
    passed = abs(mean - expected) <= 3 * error + ROUND_OFF * abs(expected)
    row = {"name": name, "own": mean, "expected": expected, "standard_error": error}
    return row | {"ok": passed}


def _log_bond(problem: "Problem", years: np.ndarray) -> np.ndarray:
    import jax

    from .curve import log_bond

    with jax.enable_x64(True):
        return np.asarray(log_bond(problem.case.curve, plain(problem.inputs), years))


def _today(problem: "Problem", found: Figures, record: paths.Record) -> dict[str, Any]:
    """Trades, key-rate ladder, collateral and stresses, with the policy's first decision."""
    case, first = problem.case, paths.first_decision(record)
    weights, places = first["weights"], first["overlay"]
    amount = float(case.assets.amount.used())
    values = np.full(case.buckets, amount)
    wanted = balance.notionals(case, places, values)
    now = np.zeros(0) if case.overlay is None else case.overlay.notional.used()
    inputs = problem.inputs
    stresses = [
        balance.stressed(case, inputs, each, now)
        for each in stress.scenarios(case, stress.read_shocks(case))
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


def _sensitivities(problem: "Problem", solution: Solution) -> dict[str, Any]:
    """Effects of the usual moves on the objective: each number alone, and all of an input's.

    With a utility of the funding ratio the effects are on the certainty equivalent (`unit` is
    "ratio"). `effect` holds the decisions, `reacting` lets the trained policy react.
    """
    table = solution.sensitivities
    if table is None:
        return {}
    known = equivalent(problem.objective, solution.value)
    slope = 1.0 if known is None else known.slope
    families, rows = [], []
    for name, given in table.inputs.items():
        move = units.move(name, given)
        shape = given.value.shape
        held = table.held[name]
        smooth = None if table.smooth is None else table.smooth[name]
        total = slope * np.array(held.along(move.size.reshape(shape)))
        family = {"input": name, "count": given.value.size, "move": move.words}
        family |= {"effect": total[0], "standard_error": total[1]}
        if smooth is not None:
            family["reacting"] = slope * smooth.along(move.size.reshape(shape))[0]
        families.append(family)
        each = (held.value.ravel(), held.standard_error.ravel(), given.names())
        for i, (value, error, label) in enumerate(zip(*each)):
            size = slope * move.size[i]
            row = {"input": name, "label": label, "move": move.words, "effect": size * value}
            row["standard_error"] = abs(size) * error
            if smooth is not None:
                row["reacting"] = size * smooth.value.ravel()[i]
            rows.append(row)
    return {"unit": "objective" if known is None else "ratio", "families": families, "rows": rows}


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
        "bump_check": [
            {
                "family": bump.input,
                "inputs": bump.direction,
                "worst_error": bump.error,
                "allowed": bump.allowed,
                "passed": bump.passed,
            }
            for bump in bumps
        ],
        "feasibility": [entry._asdict() | {"passed": entry.worst > -SLACK} for entry in limits],
        "smoothing_gap": solution.smoothing_gap,
        "policy_gradient_norm": solution.policy_gradient_norm,
    }
