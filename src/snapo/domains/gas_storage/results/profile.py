"""Inventory, flow and trigger prices over time, and today's decision by inventory."""

from typing import Any

import numpy as np

from snapo.engine import COURSE
from snapo.problem.problem import Problem
from snapo.problem.smooth import Exact
from snapo.report.quantity import long_date, quantity
from snapo.solver.solution import Solution
from snapo.study.study import Part, Setup, StudyRun, Today

from ..contract.records import StorageCase
from ..policy.network import StoragePolicy
from ..policy.triggers import Triggers, decide, triggers
from ..setup import beside, case_of, policy_of

PATHS = 4096
PRICES = 21  # spot prices of decisions.csv, from half to one and a half of the forward


def work(run: StudyRun) -> dict[str, Any]:
    """Inventory and flow over time, with bands, limits and trigger prices; today's decision."""
    setup, solution = run.setup, run.solution
    problem, case = setup.problem, case_of(setup)
    horizon, steps = problem.simulator.horizon, problem.schedule.steps
    inventory, flow = _paths(setup, solution)
    here, levels = _levels(problem.schedule)
    run.write_csv("decisions.csv", *_by_price(problem, case, policy_of(solution), levels))
    days = np.append(np.arange(horizon), np.zeros(len(levels), int))
    stock = np.append(inventory.mean(1)[:-1], levels)
    at = triggers(problem, policy_of(solution), days, stock)
    by_day, today = (Triggers(*(x[part] for x in at)) for part in _halves(horizon))
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
        "today": _today(problem, case, solution, (here, levels), today),
        "cycles": {
            "mean": injected.mean() / working_volume(case),
            "unit": "injected volume / working volume",
        },
    }


def _by_price(problem: Problem, case: StorageCase, policy: StoragePolicy, levels: np.ndarray):
    """Header and rows of `decisions.csv`: the first day's decision by spot price and inventory."""
    forward = float(problem.schedule.steps.forward[0])
    spots, stock = np.meshgrid(forward * np.linspace(0.5, 1.5, PRICES), levels, indexing="ij")
    spots, stock = spots.ravel(), stock.ravel()
    found = decide(problem, policy, 0, stock, spots)
    gas, price = case.volume_unit, f"{case.currency}/{case.volume_unit}"
    header = (
        "date", f"spot ({price})",
        *(f"{name} ({gas})" for name in ("inventory", "injection", "withdrawal")),
    )  # fmt: skip
    day = case.days[0].isoformat()
    return header, ((day, *row) for row in zip(spots, stock, found.injection, found.withdrawal))


PROFILE = Part("profile", work, needs=("training",))


def working_volume(case: StorageCase) -> float:
    """The widest span of the inventory limits."""
    contract = case.contract
    return float(contract.max_inventory.used().max() - contract.min_inventory.used().min())


def _paths(setup: Setup, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Inventories [T + 1, paths] and net injections [T, paths] of the exact simulator."""
    problem = beside(setup)
    source = problem.sources.evaluation
    bound = setup.engines.evaluate.bind(problem, controls=False)
    inventories, flows = [], []
    for block in source.blocks(source.available(PATHS), 8):
        draws = source.draws(block, problem.simulator)
        rolled = bound.values(policy_of(solution), draws, Exact(), record=COURSE)
        start = np.asarray(rolled.record["state"].inventory)
        inventories.append(np.concatenate([start, np.asarray(rolled.state.inventory)[None]]))
        outputs = rolled.record["outputs"]
        flows.append(np.asarray(outputs["injection"]) - np.asarray(outputs["withdrawal"]))
    return np.concatenate(inventories, 1), np.concatenate(flows, 1)


def _halves(horizon: int) -> tuple[slice, slice]:
    return slice(None, horizon), slice(horizon, None)


def _bands(paths: np.ndarray) -> dict[str, np.ndarray]:
    low, high = np.quantile(paths, [0.05, 0.95], axis=1)
    return {"mean": paths.mean(1), "p05": low, "p95": high}


def _levels(schedule) -> tuple[float, np.ndarray]:
    """The inventory in store, and some others over the first day's reachable interval."""
    here = float(schedule.constants.inventory)
    low, high = schedule.steps.low[0], schedule.steps.high[0]
    return here, np.unique(np.append(np.linspace(low, high, 11), here))


def today(setup: Setup, policy: StoragePolicy) -> Today:
    """The first day's decision at the forward price, by inventory in store."""
    problem, case = setup.problem, case_of(setup)
    here, levels = _levels(problem.schedule)
    at = triggers(problem, policy, np.zeros(len(levels), int), levels)
    now, rows = _ladder(problem, policy, (here, levels), at)
    gas, price = case.volume_unit, f"{case.currency}/{case.volume_unit}"
    facts = [
        ("spot", float(problem.schedule.steps.forward[0]), price),
        ("inventory", now["inventory"], gas),
        ("inject below", now["inject_below"], price),
        ("withdraw above", now["withdraw_above"], price),
    ]
    columns = [
        ("inventory", gas), ("action", ""), ("volume", gas),
        ("inject below", price), ("withdraw above", price),
    ]  # fmt: skip
    names = ("inventory", "action", "volume", "inject_below", "withdraw_above")
    volume = f" {quantity(now['volume'], gas)}" if now["volume"] else ""
    words = f"{now['action']}{volume} on {long_date(case.days[0])}"
    return Today(words, facts, columns, [[row[name] for name in names] for row in rows])


def _today(
    problem: Problem,
    case: StorageCase,
    solution: Solution,
    place: tuple[float, np.ndarray],
    at: Triggers,
) -> dict[str, Any]:
    """The first day's decision at the inventory in store, and at the other levels."""
    now, rows = _ladder(problem, policy_of(solution), place, at)
    now |= {"date": case.days[0].isoformat(), "spot": problem.schedule.steps.forward[0]}
    # The network's own price of gas is pinned down at the trigger alone; the adjoint's everywhere.
    if solution.sensitivities is not None:
        stored = solution.sensitivities.of(case.contract.inventory.name)
        now["marginal_value"] = float(stored.value.sum())
    return now | {"ladder": rows}


def _ladder(
    problem: Problem, policy: StoragePolicy, place: tuple[float, np.ndarray], at: Triggers
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The first day's decision at the inventory in store, and at every level."""
    here, levels = place
    decided = decide(problem, policy, 0, levels)
    net = decided.injection - decided.withdrawal

    def line(i: int) -> dict[str, Any]:
        return {
            "inventory": levels[i],
            "inject_below": at.injection[i],
            "withdraw_above": at.withdrawal[i],
            "action": "inject" if net[i] > 0 else "withdraw" if net[i] < 0 else "hold",
            "volume": abs(net[i]),
        }

    rows = [line(i) for i in range(len(levels))]
    return rows[int(np.flatnonzero(levels == here)[0])].copy(), rows
