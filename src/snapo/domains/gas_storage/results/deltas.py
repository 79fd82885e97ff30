"""Deltas by delivery day and month, beside the volumes of the intrinsic plan."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from snapo.study.study import Part, StudyRun

from ..setup import case_of


def work(run: StudyRun) -> dict[str, Any]:
    """By day and by delivery month: discounted, and as volumes of undiscounted futures.

    With the 95 % interval of the reported derivative, of whose half-width `sampling` is due to
    finitely many paths and `policy` to the policy's error.
    """
    setup, table = run.setup, run.solution.sensitivities
    case, steps = case_of(setup), setup.problem.schedule.steps
    days, curve = len(case.days), case.market.forward_curve.name
    if table is None:
        return {"deltas_daily": {}, "deltas_monthly": []}
    found = table.of(curve)
    moved = np.zeros(found.value.size) if table.moved is None else table.moved[curve].value
    smooth = None if table.smooth is None else table.smooth[curve]
    net = np.array(run.get("intrinsic.net"))
    sold = -net * np.where(net < 0, 1 - steps.withdrawal_fuel, 1 + steps.injection_fuel)
    rate = np.ones(found.value.size)
    rate[:days] = steps.gas_discount
    numbers = found.numbers()[:days]
    daily = {
        "discounted": found.value[:days],
        "low": np.array([interval.low for interval in numbers]),
        "high": np.array([interval.high for interval in numbers]),
        "standard_error": table.held[curve].standard_error[:days],
        "undiscounted": (found.value / rate)[:days],
        "moved": moved[:days],
        "intrinsic": sold,
    }
    months = np.array([day.strftime("%Y-%m") for day in case.days])
    monthly = []
    for month in dict.fromkeys(months):
        chosen = np.zeros(found.value.size)
        chosen[:days] = months == month
        traded = found.along(chosen / rate)
        value, low, high, sampling, policy = found.along(chosen)
        monthly.append(
            {
                "month": month,
                "discounted": value,
                "low": low,
                "high": high,
                "sampling": sampling,
                "policy": policy,
                "source": found.source,
                "standard_error": table.held[curve].along(chosen)[1],
                "undiscounted": traded.value,
                "undiscounted_low": traded.low,
                "undiscounted_high": traded.high,
                "moved": float(moved @ chosen),
                "smooth": None if smooth is None else smooth.along(chosen)[0],
                "intrinsic": float(sold @ chosen[:days]),
            }
        )
    run.write_csv("profile.csv", *_profile(run, daily))
    return {"deltas_daily": daily, "deltas_monthly": monthly}


DELTAS = Part("deltas", work, needs=("intrinsic value", "training", "profile"))


def _profile(run: StudyRun, daily: dict[str, Any]) -> tuple[tuple[str, ...], Iterable[tuple]]:
    """Header and rows of `profile.csv`, one row per decision day."""
    days = run.get("days")
    columns = {"date": days, "forward": run.get("forward")}
    for name in ("inventory", "flow"):
        for band, numbers in run.get(name).items():
            columns[f"{name}_{band}"] = numbers[: len(days)]
    columns["trigger_injection"] = run.get("trigger_injection")
    columns["trigger_withdrawal"] = run.get("trigger_withdrawal")
    columns["delta"] = daily["discounted"]
    columns["delta_undiscounted"] = daily["undiscounted"]
    return tuple(columns), zip(*columns.values())
