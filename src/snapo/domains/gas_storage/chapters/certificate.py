"""The evidence of a run: derivatives against bumps, limits, homogeneity in the curve, training,
assumptions and units."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from snapo.problem.problem import Problem
from snapo.report import evidence
from snapo.report.missing import why_missing
from snapo.report.page import Block, Facts, Section, Table, Text
from snapo.report.quantity import decimals, finite, long_date, number, percent, power
from snapo.solver.certificate import nudged
from snapo.solver.solution import Solution
from snapo.study.chapter import Number
from snapo.study.chapters.certificate import Certificate, bump_table, certificate, limit_table
from snapo.study.study import Setup, StudyRun

from ..prices.process import VOLATILITY
from ..setup import OUTPUT, case_of, on_independent_paths
from .run import StorageRun

TRIES = 16  # at finding inputs nearby that still can be met


def off_ties(problem: Problem) -> Problem:
    """The problem at slightly moved inputs, if the contract can still be met. With round numbers a
    store becomes exactly full or empty at the end of a day, and a full store without losses stays
    exactly full. The value then has a kink on every path.
    """
    for seed in range(TRIES):
        moved = nudged(problem, seed)
        steps, inventory = moved.schedule.steps, moved.schedule.constants.inventory
        if np.all(steps.low <= steps.high) and steps.low[0] <= inventory <= steps.high[0]:
            return moved
    return problem


@dataclass(frozen=True)
class Homogeneity:
    """The sum of forward price times delta (`left`), the value plus costs (`right`), and the
    `error` of their equality."""

    left: Number
    right: Number
    error: Number
    paths: int = 0


@dataclass(frozen=True)
class StorageCertificate(Certificate):
    """The checks of a store.

    - `homogeneity`: None if the price or the contract is not proportional to the curve.
    - `control_variate`: {"explained": the share of the variance that it removes}.
    """

    homogeneity: Homogeneity | None = None
    control_variate: dict[str, float | None] = field(default_factory=dict)


def homogeneity(setup: Setup, solution: Solution) -> Homogeneity | None:
    """The check that the sum of F x delta equals the value plus the present value of costs, with
    decisions held fixed, on the same paths. This holds path by path for any policy, if prices are
    the forward curve times noise, and all cash flows are payments for gas or costs per unit.
    """
    table, case = solution.sensitivities, case_of(setup)
    if table is None or not case.model.proportional:
        return None
    evaluation = setup.evaluation.within(setup.problem.simulator.horizon)
    curve = case.market.forward_curve
    source = setup.problem.sources.evaluation
    paths = source.available(min(evaluation.sensitivity_paths, evaluation.paths))
    left = float(np.sum(curve.values * table.held[curve.name].value))
    earned = np.asarray(solution.totals[OUTPUT]) + np.asarray(solution.totals["costs"])
    right = float(np.mean(earned[:paths]))
    return Homogeneity(left, right, left - right, paths)


def _more(run: StudyRun) -> dict[str, Any]:
    return {
        "homogeneity": homogeneity(run.setup, run.solution),
        "control_variate": {"explained": run.solution.control},
    }


def show_certificate(run: StorageRun, result: StorageCertificate) -> list[Block]:
    """Key figures, a table of derivatives against bumps, and a table of all limits."""
    facts = _facts(run, result)
    return [
        *([Facts(facts)] if facts else []),
        bump_table(result, run.currency, lambda name: run.input_number(name).title()),
        limit_table(result, run.volume, "Day", lambda step: _day(run, step)),
    ]


def _facts(run: StorageRun, result: StorageCertificate) -> list[tuple[str, str, str]]:
    facts = []
    if (gap := finite(result.smoothing_gap)) is not None:
        value = run.result.value
        share = f" ({percent(gap / abs(value), 2)})" if value else ""
        facts.append(("Smoothing gap", run.money(gap), f"exact minus smooth{share}"))
    facts += evidence.gradient(run)
    if (sums := result.homogeneity) is not None:
        digits = decimals([sums.left, sums.right])
        note = f"value + costs: {run.money(sums.right, digits)}; difference {power(sums.error)}"
        facts.append(("Σ forward × delta", run.money(sums.left, digits), note))
    facts += [
        (f"Control variate: {key.replace('_', ' ')}", number(share), "")
        for key, share in result.control_variate.items()
    ]
    return facts


def _day(run: StorageRun, step: Any) -> str:
    index, days = finite(step), run.days
    if index is None or days is None or not 0 <= index < len(days):
        return number(index, 0)
    return long_date(days[int(index)])


CERTIFICATE = certificate(
    bump_paths=512,
    tolerance=lambda problem: 1e-6 * float(problem.schedule.constants.rate_scale),
    near=off_ties,
    problem_of=on_independent_paths,
    result=StorageCertificate,
    more=_more,
    show=show_certificate,
)


def history(run: StorageRun) -> Section:
    """The objective and the gradient norm over the steps of training."""
    return evidence.training_history(run, run.currency)


def assumptions(run: StorageRun) -> Section:
    """The price model, and the meaning of the units."""
    blocks: list[Block] = [Text(str(run.get("model")))] if run.get("model") else []
    if not blocks:
        blocks.append(why_missing(run, "training"))
    title = "Assumptions and units"
    return Section("assumptions", title, "Assumptions", [*blocks, _glossary(run)])


def _volatility(run: StorageRun) -> tuple[str, str, str]:
    """The row on volatilities: of prices in money, or of their logarithm."""
    unit = next((x.unit for x in run.inputs.values() if x.group == "volatility"), "")
    if unit in ("", VOLATILITY.unit):
        return (
            "Volatility",
            "per √year",
            "volatility of the logarithm of the price; 1 point is 0.01",
        )
    return "Volatility", unit.replace("sqrt(year)", "√year"), "volatility of the price itself"


def _glossary(run: StorageRun) -> Table:
    money, gas = run.currency or "currency", run.volume
    rows = [
        ("Value", money, "present value on the valuation date, contract as written"),
        ("Price", run.price, "forward and spot prices, trigger prices, undiscounted"),
        ("Volume", gas, "inventory, and volume per day for flows and rates"),
        ("Delta", gas, "change of value for a rise of 1 in one forward price, with decisions held"
         " fixed"),
        ("Discounted delta", gas, "delta of the present value; divided by the discount factor of "
            "the settlement of the month, it is the volume of futures"),
        ("Intrinsic", gas, "volumes of the best plan fixed today on the forward curve"),
        ("Delta through the smooth rules", gas, "delta under the smooth rules, with the policy "
            "reacting; a diagnostic"),
        _volatility(run),
        ("±", "", "half of the 95 % interval of an estimate, simulation error only"),
        ("Cycles", "", "volume injected over the life of the contract, divided by the working "
            "volume"),
    ]  # fmt: skip
    return Table([("Term", ""), ("Unit", ""), ("Meaning", "")], rows, "Terms and units", 3)
