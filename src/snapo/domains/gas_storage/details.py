"""Everything that the report of a storage run shows, as plain data (`details.json`)."""

from collections.abc import Iterable
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from snapo.case.given import Given
from snapo.problem.inputs import Input
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Pseudo, Scenarios
from snapo.problem.smooth import Exact
from snapo.solver import certificate
from snapo.solver.evaluate import estimate, path_totals
from snapo.solver.solution import Solution
from snapo.solver.train import EVALUATE_STREAM

from .decisions import Triggers, decide, triggers
from .expiry import fixed_costs_value
from .intrinsic import Plan
from .policy import GuidePolicy
from .records import StorageCase, SuppliedModel
from .shadow import shadow_prices

if TYPE_CHECKING:
    from .run import Problem

PROFILE_PATHS, GUIDE_PATHS = 4096, 16384
TRIES = 16  # at finding inputs nearby that still can be met
QUANTILES = (1, 5, 25, 50, 75, 95, 99)
NOT_VEGAS = ("forward_curve", "zero_rate", "ratchet_inventory")


def details(
    problem: "Problem", solution: Solution, plan: Plan, known: dict[str, float | None]
) -> dict[str, Any]:
    """All figures and tables of the report; volumes and money in the case's own units."""
    case = problem.case
    source = _source(problem)
    profile = _profile(problem, solution, source)
    daily, monthly = _deltas(problem, solution, plan)
    return {
        "title": case.title,
        "currency": case.currency,
        "volume_unit": case.volume_unit,
        "valuation_date": case.valuation_date.isoformat(),
        "start": case.start.isoformat(),
        "end": case.end.isoformat(),
        "days": [day.isoformat() for day in case.days],
        "model": _model(case),
        "notes": list(case.notes),
        "forward": problem.schedule.steps.forward,
        "fixed_costs": fixed_costs_value(case),
        "break_even_fee": _break_even_fee(problem, solution),
        "value_ladder": _ladder(problem, solution, known),
        **profile,
        "deltas_daily": daily,
        "deltas_monthly": monthly,
        "vegas": _vegas(solution),
        "shadow_prices": shadow_prices(problem, solution.policy, source),
        "cash_flow": _distribution(np.asarray(solution.totals["cash_flow"])),
        "certificate": _certificate(problem, solution, source),
        "seconds": dict(solution.seconds),
        "versions": dict(solution.versions),
        "seed": solution.seed,
        "engine": {"name": solution.engine, "reason": solution.reason},
        "paths": dict(solution.paths),
    }


def profile_rows(found: dict[str, Any]) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `profile.csv`, one row per decision day."""
    columns = {"date": found["days"], "forward": found["forward"]}
    for name in ("inventory", "flow"):
        for band, numbers in found[name].items():
            columns[f"{name}_{band}"] = numbers[: len(found["days"])]
    columns["trigger_injection"] = found["trigger_injection"]
    columns["trigger_withdrawal"] = found["trigger_withdrawal"]
    columns["delta"] = found["deltas_daily"]["discounted"]
    columns["delta_undiscounted"] = found["deltas_daily"]["undiscounted"]
    return tuple(columns), zip(*columns.values())


def _source(problem: "Problem") -> Scenarios:
    from .run import supplied

    if isinstance(problem.case.model, SuppliedModel):
        return supplied(problem.case.model.evaluation, problem.simulator)
    return Pseudo(problem.training.seed, stream=(EVALUATE_STREAM << 32) + 1)


def _available(problem: "Problem", wanted: int) -> int:
    model = problem.case.model
    return min(wanted, len(model.evaluation)) if isinstance(model, SuppliedModel) else wanted


def _profile(problem: "Problem", solution: Solution, source: Scenarios) -> dict[str, Any]:
    """Inventory and flow over time, with bands, limits and trigger prices; today's decision."""
    simulator, schedule, case = problem.simulator, problem.schedule, problem.case
    engine, inventories, flows = problem.engines.evaluate, [], []
    for block in source.blocks(_available(problem, PROFILE_PATHS), 8):
        draws = source.draws(block, simulator)
        given = (simulator, solution.policy, schedule, draws, Exact())
        rolled = engine.values(*given, record=("state", "outputs"))
        start = np.asarray(rolled.record["state"].inventory)
        inventories.append(np.concatenate([start, np.asarray(rolled.state.inventory)[None]]))
        outputs = rolled.record["outputs"]
        flows.append(np.asarray(outputs["injection"]) - np.asarray(outputs["withdrawal"]))
    inventory, flow = np.concatenate(inventories, 1), np.concatenate(flows, 1)
    expected = inventory.mean(1)
    here, levels = _levels(schedule)
    days = np.append(np.arange(simulator.horizon), np.zeros(len(levels), int))
    at = triggers(simulator, schedule, solution.policy, days, np.append(expected[:-1], levels))
    by_day = Triggers(*(x[: simulator.horizon] for x in at))
    today = Triggers(*(x[simulator.horizon :] for x in at))
    steps = schedule.steps
    limits = case.contract.min_inventory.used(), case.contract.max_inventory.used()
    injected = np.asarray(solution.totals["injection"])
    return {
        "inventory": _bands(inventory),
        "flow": _bands(flow),
        "trigger_injection": by_day.injection,
        "trigger_withdrawal": by_day.withdrawal,
        "reachable": {
            "low": np.append(steps.low, steps.next_low[-1]),
            "high": np.append(steps.high, steps.next_high[-1]),
        },
        "limits": {"low": limits[0], "high": limits[1]},
        "today": _today(problem, solution, here, levels, today),
        "cycles": {
            "mean": injected.mean() / working_volume(case),
            "unit": "injected volume / working volume",
        },
    }


def _bands(paths: np.ndarray) -> dict[str, np.ndarray]:
    low, high = np.quantile(paths, [0.05, 0.95], axis=1)
    return {"mean": paths.mean(1), "p05": low, "p95": high}


def _levels(schedule) -> tuple[float, np.ndarray]:
    """The inventory in store, and some others over the first day's reachable interval."""
    here = float(schedule.constants.inventory)
    low, high = schedule.steps.low[0], schedule.steps.high[0]
    return here, np.unique(np.append(np.linspace(low, high, 11), here))


def _today(
    problem: "Problem", solution: Solution, here: float, levels: np.ndarray, at: Triggers
) -> dict[str, Any]:
    """The first day's decision at the inventory in store, and at the other levels."""
    case, schedule = problem.case, problem.schedule
    decided = decide(problem.simulator, schedule, solution.policy, 0, levels)
    net = decided.injection - decided.withdrawal

    def line(i: int) -> dict[str, Any]:
        return {
            "inventory": levels[i],
            "inject_below": at.injection[i],
            "withdraw_above": at.withdrawal[i],
            "action": "inject" if net[i] > 0 else "withdraw" if net[i] < 0 else "hold",
            "volume": abs(net[i]),
        }

    now = line(int(np.flatnonzero(levels == here)[0]))
    now |= {"date": case.days[0].isoformat(), "spot": schedule.steps.forward[0]}
    # The network's own price of gas is pinned down at the trigger alone; the adjoint's everywhere.
    if solution.sensitivities is not None:
        stored = solution.sensitivities.held[case.contract.inventory.name]
        now["marginal_value"] = float(stored.value.sum())
    return now | {"ladder": [line(i) for i in range(len(levels))]}


def _deltas(problem: "Problem", solution: Solution, plan: Plan):
    """Deltas by day and by delivery month: discounted, and as volumes of undiscounted futures."""
    case, steps = problem.case, problem.schedule.steps
    table, days = solution.sensitivities, len(case.days)
    if table is None:
        return {}, []
    found = table.held["forward_curve"]
    discount = steps.gas_discount
    moved = np.zeros(found.value.size) if table.moved is None else table.moved["forward_curve"]
    smooth = None if table.smooth is None else table.smooth["forward_curve"]
    sold = -plan.net * np.where(plan.net < 0, 1 - steps.withdrawal_fuel, 1 + steps.injection_fuel)
    daily = {
        "discounted": found.value[:days],
        "standard_error": found.standard_error[:days],
        "undiscounted": found.value[:days] / discount,
        "moved": moved[:days],
        "intrinsic": sold,
    }
    months = np.array([day.strftime("%Y-%m") for day in case.days])
    monthly = []
    for month in dict.fromkeys(months):
        chosen = np.zeros(found.value.size)
        chosen[:days] = months == month
        value, error = found.along(chosen)
        rate = np.ones(found.value.size)
        rate[:days] = discount
        monthly.append(
            {
                "month": month,
                "discounted": value,
                "standard_error": error,
                "undiscounted": found.along(chosen / rate)[0],
                "moved": float(moved @ chosen),
                "smooth": None if smooth is None else smooth.along(chosen)[0],
                "intrinsic": float(sold @ chosen[:days]),
            }
        )
    return daily, monthly


def _vegas(solution: Solution) -> list[dict[str, Any]]:
    """Sensitivities to everything but the curves, per one unit of the input."""
    if solution.sensitivities is None:
        return []
    rows = solution.sensitivities.rows()
    return [row._asdict() for row in rows if row.input not in NOT_VEGAS]


def _ladder(problem: "Problem", solution: Solution, known) -> list[dict[str, Any]]:
    """Intrinsic, the guide's rule, the trained policy, the reference, and after fixed costs."""
    paths = _available(problem, GUIDE_PATHS)
    source = _source(problem)
    given = (problem.engines.evaluate, problem.simulator, GuidePolicy(), problem.schedule, source)
    totals = path_totals(*given, paths, Exact())
    guide = estimate(problem.objective, totals, source, problem.simulator.control_variates())

    def rung(name, value, error=None, note=""):
        return {"name": name, "value": value, "standard_error": error, "note": note}

    ladder = [
        rung("Intrinsic", known["intrinsic"], note="best fixed plan against today's curve"),
        rung("One-factor rule", *guide[:2], note="dynamic program in the fastest factor alone"),
        rung(
            "Trained policy",
            solution.value,
            solution.standard_error,
            "exact simulator, fresh paths",
        ),
    ]
    if known.get("dynamic_programming") is not None:
        note = "lattice in at most two price factors"
        ladder.append(rung("Dynamic programming", known["dynamic_programming"], note=note))
    fees = fixed_costs_value(problem.case)
    if fees:
        after = solution.value - fees
        ladder.append(
            rung("After fixed costs", after, solution.standard_error, "less their present value")
        )
    return ladder


def _break_even_fee(problem: "Problem", solution: Solution) -> float:
    """The fee per unit of working volume, paid today, at which the contract is worth nothing."""
    volume = working_volume(problem.case)
    return solution.value / volume if volume > 0 else float("nan")


def working_volume(case: StorageCase) -> float:
    """The widest span of the inventory limits."""
    contract = case.contract
    return float(contract.max_inventory.used().max() - contract.min_inventory.used().min())


def _distribution(cash: np.ndarray) -> dict[str, Any]:
    counts, edges = np.histogram(cash, bins=60)
    return {
        "edges": edges,
        "counts": counts,
        "mean": cash.mean(),
        "standard_deviation": cash.std(),
        "quantiles": {str(q): np.quantile(cash, q / 100) for q in QUANTILES},
    }


def _certificate(problem: "Problem", solution: Solution, source: Scenarios) -> dict[str, Any]:
    """The adjoint against bumps, limits kept, the smoothing gap, and homogeneity in the curve."""
    engine = problem.engines.evaluate
    given = (problem.simulator, off_ties(problem), solution.policy, problem.objective, source)
    bumps = certificate.bump_check(*given, _available(problem, 512), engine=engine)
    limits = certificate.feasibility(
        problem.simulator,
        problem.schedule,
        solution.policy,
        source,
        _available(problem, 4096),
        engine,
    )
    slack = 1e-6 * float(problem.schedule.constants.rate_scale)
    return {
        "bump_check": [bump.row() for bump in bumps],
        "feasibility": [limit.row(slack) for limit in limits],
        "smoothing_gap": solution.smoothing_gap,
        "policy_gradient_norm": solution.policy_gradient_norm,
        "homogeneity": homogeneity(problem, solution),
        "control_variate": {"explained": solution.control},
    }


def off_ties(problem: "Problem") -> dict[str, Input]:
    """The inputs a hair away, where the contract still can be met, for a check by differences.

    With round numbers a store fills or empties on the very day that its rates allow, and a full
    one without losses stays exactly full: kinks on every path.
    """
    rate = float(problem.schedule.constants.rate_scale)
    zeros = {"min_inventory": 5e-4 * rate, "end_inventory": 1e-3 * rate, "inventory_loss": 1e-4}
    for seed in range(TRIES):
        inputs = certificate.nudged(problem.inputs, zeros, seed)
        schedule = prepare(problem.simulator, inputs)
        steps, inventory = schedule.steps, schedule.constants.inventory
        if np.all(steps.low <= steps.high) and steps.low[0] <= inventory <= steps.high[0]:
            return inputs
    return problem.inputs


def homogeneity(problem: "Problem", solution: Solution) -> dict[str, float] | None:
    """Sum of F x delta = value + present value of costs, decisions held, on the same paths.

    It holds path by path for any policy, where prices are the forward curve times noise and all
    of the value is paid in gas and proportional costs.
    """
    table, case = solution.sensitivities, problem.case
    if table is None or (isinstance(case.model, SuppliedModel) and not case.model.rescaled):
        return None
    paths = sum(len(b) for b in _sensitivity_blocks(problem))
    forward = case.market.forward_curve.values
    left = float(np.sum(forward * table.held["forward_curve"].value))
    weights = np.concatenate([np.full(len(b), 1 / len(b)) for b in _sensitivity_blocks(problem)])
    number = np.concatenate(_sensitivity_blocks(problem))
    cash = np.asarray(solution.totals["cash_flow"])[number]
    costs = np.asarray(solution.totals["costs"])[number]
    right = float(np.sum((cash + costs) * weights) / len(_sensitivity_blocks(problem)))
    return {"left": left, "right": right, "error": left - right, "paths": paths}


def _sensitivity_blocks(problem: "Problem") -> list[np.ndarray]:
    evaluation = problem.evaluation
    source = problem.evaluation.source(problem.training.seed)
    if isinstance(problem.case.model, SuppliedModel):
        source = _source(problem)
    return source.blocks(min(evaluation.sensitivity_paths, evaluation.paths))


def _model(case: StorageCase) -> str:
    kind = {
        "one-factor": "One factor, mean-reverting, volatility by delivery day",
        "multi-factor": "Correlated mean-reverting factors",
        "three-factor-seasonal": "Three factors: spot (mean-reverting), long-term, seasonal",
        "supplied": "Supplied price paths",
    }[case.model.kind]
    given = [getattr(case.model, f.name) for f in fields(case.model)]
    numbers = [
        f"{g.name.replace('_', ' ')} {g.values[0]:g} {g.unit}"
        for g in given
        if isinstance(g, Given) and len(g.values) == 1
    ]
    return "; ".join([kind, *numbers])
