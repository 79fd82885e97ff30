"""A made-up run folder of the size and shape of the flagship case, for tests of the report.

Nothing here is a result: prices and contract are the case's, every other number is invented.
"""

import csv
import datetime
import json
from pathlib import Path

import numpy as np

from snapo.report.folder import SENSITIVITIES
from snapo.study.run_folder import LAYOUT

FIRST, END = datetime.date(2021, 4, 25), datetime.date(2022, 4, 1)
PRICES = [16.61, 15.68, 15.42, 15.31, 15.27, 15.13, 15.96, 17.22, 17.32, 17.66, 17.59, 16.81]
DELTAS = [760, -1012, -471, -243, -236, -1541, -160, 1801, 512, 1598, 1822, 1371]
INTRINSIC = [900, -2250, 0, 0, 0, -3400, 0, 1100, 0, 1450, 2700, 1000]
# Net withdrawals by month; with the 1,500 in store they end at zero.
FLOWS = [500, -1650, -900, -520, -610, -2080, -240, 1700, 560, 1700, 1840, 1200]
LEVELS, WITHDRAWAL, INJECTION = (
    [0.0, 2000.0, 5000.0, 7000.0],
    [150.0, 200.0, 260.0, 275.0],
    [250.0, 175.0, 155.0, 132.0],
)


def write_run(folder: Path, **changes) -> Path:
    """Writes the files of a run; `changes` replace keys of its tables, None takes one away."""
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    details = {**sample_details(), **changes}
    details = {key: value for key, value in details.items() if value is not None}
    about = {key: details.pop(key) for key in ABOUT if key in details}
    states = {part: {"state": "done", "note": "", "seconds": 1.0} for part in PARTS}
    _write(folder / "run.json", json.dumps({"layout": LAYOUT, "about": about, "parts": states}))
    _write(folder / "parts" / "profile.json", json.dumps(details))
    _write(folder / "result.json", json.dumps(RESULT))
    _table(folder / "sensitivities.csv", _sensitivities())
    _table(folder / "profile.csv", _profile(sample_details()))
    _table(folder / "history.csv", _history())
    return folder


ABOUT = ("title", "currency", "volume_unit", "valuation_date", "start", "end", "days", "model")
ABOUT += ("notes", "forward", "inputs", "fixed_costs")
PARTS = ("intrinsic value", "training", "profile", "deltas", "shadow prices", "certificate")
RESULT = {
    "kind": "gas-storage",
    "value": 78241.6,
    "standard_error": 38.4,
    "smooth_value": 78190.2,
    "smoothing_gap": 51.4,
    "policy_gradient_norm": 2.31,
    "references": {"intrinsic": 40992.1, "dynamic_programming": 78370.0},
    "seconds": {"compile": 6.4, "train": 41.2, "evaluate": 9.8, "total": 58.7},
    "engine": "xla",
    "paths": {"train": 512, "evaluate": 65536},
    "seed": 1,
    "status": "converged",
    "run": "run",
}


def sample_days() -> list[datetime.date]:
    return [FIRST + datetime.timedelta(i) for i in range((END - FIRST).days)]


def _month(day: datetime.date) -> int:
    return (day.year - 2021) * 12 + day.month - 4


def sample_details() -> dict:
    """details.json, seeded: the same at every call."""
    random = np.random.default_rng(7)
    days = sample_days()
    month = np.array([_month(day) for day in days])
    length = np.bincount(month)[month]
    forward = np.array(PRICES)[month]
    flow = -np.array(FLOWS, float)[month] / length
    inventory = np.concatenate([[1500.0], 1500.0 + np.cumsum(flow)])
    low, high = _reachable(len(days))
    spread = 1500 * np.sin(np.linspace(0, np.pi, len(days) + 1)) ** 0.6
    daily = np.array(DELTAS, float)[month] / length * (1 + 0.06 * random.normal(size=len(days)))
    discount = np.linspace(0.9995, 0.991, len(days))
    spot = 16.61
    return {
        "title": "G1: three-factor storage with ratchets",
        "currency": "EUR",
        "volume_unit": "MWh",
        "valuation_date": FIRST.isoformat(),
        "start": "2021-04-01",
        "end": END.isoformat(),
        "days": [day.isoformat() for day in days],
        "model": "Three-factor seasonal: spot mean reversion 91.0, spot volatility 0.85, "
        "long-term volatility 0.30, seasonal volatility 0.19.",
        "notes": ["Gas settles on day 20 of the month after delivery; costs on the flow day."],
        "value_ladder": [
            _rung("Intrinsic", 40992.1, None, "the best plan fixed today on the forward curve"),
            _rung("One-factor rule", 76102.9, 41.0, "lattice rule of the spot factor"),
            _rung("Trained policy", 78241.6, 38.4, "can be followed: a lower bound"),
            _rung("Dynamic programming", 78370.0, None, "reference on a lattice"),
            _rung("After fixed costs", 64241.6, 38.4, "trained policy less fixed costs"),
        ],
        "bound": {
            "lower": _estimate(78262.6, 10.3),
            "upper": _estimate(78466.6, 9.4),
            "gap": _estimate(204.0, 5.2),
            "penalty": "value",
            "words": "the innovations of a fitted value of the store",
            "scale": [1.0, 1.0, 1.0],
            "paths": 1024,
        },
        "break_even_fee": 11.1774,
        "fixed_costs": 14000.0,
        "forward": forward.tolist(),
        "trigger_injection": (forward * 0.985 - 0.35 + 0.25 * np.sin(month / 2.0)).tolist(),
        "trigger_withdrawal": (forward * 0.985 - 0.30 + 0.25 * np.sin(month / 2.0)).tolist(),
        "inventory": {
            "mean": inventory.tolist(),
            "p05": np.maximum(inventory - spread, low).tolist(),
            "p95": np.minimum(inventory + spread, high).tolist(),
        },
        "reachable": {"low": low.tolist(), "high": high.tolist()},
        "limits": {"low": [0.0] * len(low), "high": [7000.0] * len(low)},
        "flow": {name: (flow + shift).tolist() for name, shift in FLOW_BAND},
        "deltas_daily": {
            "discounted": (daily * discount).tolist(),
            "standard_error": (0.6 + 0.2 * random.random(len(days))).tolist(),
            "low": (daily * discount - 1.5).tolist(),
            "high": (daily * discount + 1.5).tolist(),
            "undiscounted": daily.tolist(),
            "moved": (0.05 * daily).tolist(),
            "intrinsic": (np.array(INTRINSIC, float)[month] / length).tolist(),
        },
        "deltas_monthly": [_monthly(i, random) for i in range(12)],
        "inputs": INPUTS,
        "shadow_prices": [
            _shadow("working volume", 0.412, 0.418, "MWh"),
            _shadow("injection capacity", 96.2, 98.8, "MWh/day"),
            _shadow("withdrawal capacity", 61.4, 62.9, "MWh/day"),
            _shadow("gas in store today", 16.31, 16.38, "MWh"),
        ],
        "today": {
            **_today(1500.0, spot),
            "date": FIRST.isoformat(),
            "spot": spot,
            "marginal_value": 16.13,
            "ladder": [_today(level, spot) for level in np.linspace(0, 7000, 29)],
        },
        "cash_flow": _cash_flow(random),
        "cycles": {"mean": 2.41, "unit": "injected volume / working volume"},
        "certificate": CERTIFICATE,
        "seconds": RESULT["seconds"],
        "versions": {"snapo": "0.1.0", "jax": "0.10.2", "numpy": "2.4.6", "python": "3.11"},
        "seed": 1,
        "engine": {"name": "xla", "reason": "asked for"},
        "paths": {"train": 512, "evaluate": 65536},
    }


FLOW_BAND = (("mean", 0.0), ("p05", -120.0), ("p95", 120.0))


def _estimate(value: float, error: float) -> dict:
    low, high = value - 1.96 * error, value + 1.96 * error
    return {"value": value, "standard_error": error, "low": low, "high": high}


def _rung(name, value, error, note):
    return {"name": name, "value": value, "standard_error": error, "note": note}


def _said(group, unit, move=None, trade_unit="", factor=1.0, words="some words"):
    said = {"group": group, "unit": unit, "move": move, "words": words}
    return said | {"trade_unit": trade_unit, "trade_factor": factor}


VOLATILITY = _said("volatility", "1/sqrt(year)", 0.01, "volatility point", 100.0)
INPUTS = {
    "forward_curve": _said("price", "EUR/MWh"),
    "interest_rate": _said("interest rate", "1/year", 0.001, "bp", 1e4, "continuous zero rate"),
    "spot_volatility": VOLATILITY,
    "long_term_volatility": VOLATILITY,
    "seasonal_volatility": VOLATILITY,
    "spot_mean_reversion": _said("price model", "1/year", 1.0),
    "injection_cost": _said("cost", "EUR/MWh", 0.01, words="per unit injected"),
    "withdrawal_cost": _said("cost", "EUR/MWh", 0.01, words="per unit withdrawn"),
    "inventory": _said("contract", "MWh", 1.0),
}


def _shadow(name, up, down, unit):
    return {"name": name, "up": up, "down": down, "unit": unit}


def _monthly(i: int, random) -> dict:
    discount = 0.9995 - 0.0007 * i
    return {
        "month": f"{2021 + (i + 3) // 12}-{(i + 3) % 12 + 1:02d}",
        "discounted": DELTAS[i] * discount,
        "standard_error": 11.0 + 5.0 * random.random(),
        "low": DELTAS[i] * discount - 30.0,
        "high": DELTAS[i] * discount + 30.0,
        "sampling": 24.0,
        "policy": 6.0,
        "source": "held",
        "undiscounted": float(DELTAS[i]),
        "undiscounted_low": DELTAS[i] - 30.0,
        "undiscounted_high": DELTAS[i] + 30.0,
        "moved": 40.0 * random.normal(),
        "smooth": DELTAS[i] * discount + 25 * random.normal(),
        "intrinsic": float(INTRINSIC[i]),
    }


def _today(level: float, spot: float) -> dict:
    worth = 17.05 - 0.00062 * level + 4e-9 * level**2
    below, above = worth - 0.03, worth + 0.03
    action = "inject" if spot < below else "withdraw" if spot > above else "hold"
    volume = {
        "inject": min(np.interp(level, LEVELS, INJECTION), 7000.0 - level),
        "withdraw": -min(np.interp(level, LEVELS, WITHDRAWAL), level),
        "hold": 0.0,
    }[action]
    return {
        "inventory": float(level),
        "inject_below": below,
        "withdraw_above": above,
        "action": action,
        "volume": float(volume),
    }


def _reachable(days: int):
    """Backwards from an empty end; linear ratchets."""
    low, high = np.zeros(days + 1), np.zeros(days + 1)
    levels = np.linspace(0, 7000, 2001)
    after = levels - np.interp(levels, LEVELS, WITHDRAWAL)
    for t in range(days - 1, -1, -1):
        high[t] = np.interp(high[t + 1], after, levels)
    return low, np.minimum(high, 7000.0)


def _cash_flow(random) -> dict:
    flows = 78241.6 + 9800 * (random.gamma(9.0, size=65536) - 9.0) / 3.0
    counts, edges = np.histogram(flows, 60, range=(45000.0, 130000.0))
    quantiles = {str(q): float(np.quantile(flows, q / 100)) for q in (1, 5, 25, 50, 75, 95, 99)}
    return {
        "edges": edges.tolist(),
        "counts": counts.tolist(),
        "mean": 78241.6,
        "standard_deviation": float(flows.std()),
        "quantiles": quantiles,
    }


def _bump(family, error, inputs):
    return {
        "family": family,
        "worst_error": error,
        "allowed": 1e-6,
        "passed": error < 1e-6,
        "inputs": inputs,
    }


def _feasible(limit, worst, path, step):
    return {"limit": limit, "worst": worst, "path": path, "step": step, "passed": True}


CERTIFICATE = {
    "bump_check": [
        _bump("forward_curve", 2.1e-9, "random direction"),
        _bump("interest_rate", 4.4e-9, "random direction"),
        _bump("model", 8.7e-9, ""),
        _bump("costs", 1.2e-10, ""),
        _bump("ratchets", 3.3e-8, "random direction"),
        _bump("inventory", 5.0e-10, ""),
    ],
    "feasibility": [
        _feasible("maximum inventory", 0.0, 2048, 188),
        _feasible("minimum inventory", -4.5e-13, 4711, 340),
        _feasible("injection rate", 12.5, 17, 3),
    ],
    "smoothing_gap": 51.4,
    "policy_gradient_norm": 2.31,
    "homogeneity": {"left": 79247.1, "right": 79247.1, "error": 3.1e-10},
    "control_variate": {"variance_ratio": 0.021},
}


def _sensitivities():
    yield SENSITIVITIES
    for name, label, value, error, unit in _held():
        low, high = value - error, value + error
        beside = (value, error, value * 1.01, error, 0.001 * value, error)
        yield (name, label, unit, "held", value, low, high, error, 0.0, *beside)


def _held():
    """Input, label, held derivative, its standard error and the input's unit."""
    month = [_month(day) for day in sample_days()]
    for day, i in zip(sample_days(), month, strict=True):
        yield ("forward_curve", day.isoformat(), DELTAS[i] / month.count(i), 0.7, "EUR/MWh")
    for label, value in (("2021-04-25", -310.0), ("2021-12-01", -4100.0), ("2022-04-01", -9020.0)):
        yield ("interest_rate", label, value, 12.0, "1/year")
    yield ("spot_volatility", "", 42170.0, 310.0, "1/year")
    yield ("long_term_volatility", "", 40.0, 90.0, "1/year")
    yield ("seasonal_volatility", "", 8820.0, 240.0, "1/year")
    yield ("spot_mean_reversion", "", -148.2, 1.6, "1/year")
    yield ("injection_cost", "", -16900.0, 30.0, "EUR/MWh")
    yield ("withdrawal_cost", "", -18400.0, 30.0, "EUR/MWh")
    yield ("inventory", "", 16.34, 0.02, "MWh")


def _profile(details):
    yield ("date", "forward", "inventory_mean", "inventory_p05", "inventory_p95", "flow_mean")
    stock = details["inventory"]
    for t, day in enumerate(details["days"]):
        levels = (stock[name][t] for name in ("mean", "p05", "p95"))
        yield (day, details["forward"][t], *levels, details["flow"]["mean"][t])


def _history():
    yield HISTORY
    random = np.random.default_rng(3)
    best = -np.inf
    for step in range(600):
        level = 78250 - 9000 * np.exp(-step / 60)
        exact = ""
        if step % 25 == 24:
            exact = level - 60 + 40 * random.normal()
            best = max(best, exact)
        shown = best if np.isfinite(best) else ""
        norm = 3000 * np.exp(-step / 90) * (1 + 0.3 * random.random()) + 20
        heat = 0.3 * 0.01 ** (step / 600)
        noise = level + 500 * random.normal()
        yield (step, noise, norm, heat, 0, exact, shown, 0.07 * step)


HISTORY = [
    "step",
    "objective",
    "gradient_norm",
    "temperature",
    "bad_paths",
    "exact",
    "best",
    "seconds",
]


def _table(file: Path, rows) -> None:
    with file.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows(rows)


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8")
