"""Tiny cases that between them use every key, word and column of the format; see `test_every_key`."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np

from snapo.domains.pension.fund.observation import FEATURES
from snapo.domains.pension.records.case import PARTS

# Every kind of class, with every column that its kind has.
ASSETS = (
    "name,kind,mean,volatility,weight,low,high,group,group_low,group_high,max_sale,band,cost,fee,"
    "maturity,coupon,rating,currency,smoothing,eligible,risk"
    """
Cash,cash,,,0.1,0,0.5,,,,,,0,0,,,,,,1,
Bonds,bond,,,0.1,0,0.6,Matching,0.1,0.9,,0.01,0.0003,0.0002,10,,,,,0.9,
Coupons,coupon-bond,,,0.1,0,0.6,Matching,,,,0.01,0.0003,0.0002,10,par,,,,0.9,
Linkers,index-linked,,,0.1,0,0.6,Matching,,,,0.01,0.0004,0.0002,10,,,,,0.8,
Credit,credit,,,0.1,0,0.3,Matching,,,,,0.003,0.001,5,,BBB,,,0.5,
Equity,equity,0.05,steps.csv,0.2,0,0.6,,,,,0.01,0.001,0.001,,,,USD,,0,emerging
Property,property,0.04,0.15,0.1,0,0.2,,,,0.1,,0.01,0.005,,,,,0.4,0,
Gold,commodity,0.03,0.2,0.1,0,0.2,,,,,,0.002,0.001,,,,,0.9,0,
Hedge,hedge-fund,0.04,0.1,0.1,0,0.2,,,,0.5,,0.002,0.01,,,,USD,0.5,0,
"""
)
NAMES = ("Cash", "Bonds", "Coupons", "Linkers", "Credit", "Equity", "Property", "Gold", "Hedge")
COHORTS = """
name,status,sex,age,number,pension,salary,service,mortality
Active,active,male,60.5,10,3,40,20,
Deferred,deferred,female,55,5,2,,10,
Pensioner,pensioner,female,72,8,6,,,0.9
Spouse,spouse,female,80,2,3,,,1.1
"""
FILES = {
    "zero.csv": "tenor,zero\n1,0.02\n10,0.024\n30,0.025\n",
    "forward.csv": "tenor,forward\n1,0.02\n10,0.025\n30,0.026\n",
    "swaps.csv": "tenor,swap\n1,0.02\n10,0.024\n20,0.025\n30,0.024\n",
    "break_evens.csv": "tenor,rate\n1,0.018\n30,0.02\n",
    "forward_prices.csv": "tenor,forward\n1,0.018\n30,0.021\n",
    "steps.csv": "from_year,value\n0,0.1\n1,0.12\n",
    "rates.csv": "from_year,value\n0,0.008\n1,0.009\n",
    "assets.csv": ASSETS,
    "credit.csv": "rating,spread,mean_spread,mean_reversion,volatility,default_loss\n"
    "BBB,0.013,0.015,0.4,0.3,0.002\n",
    "currencies.csv": "currency,market,volatility,premium,hedge_ratio,hedge_cost\n"
    "USD,developed,0.09,0.001,0.5,0.002\n",
    "correlations.csv": "name,rate,Equity\nrate,1,\nEquity,1,1\n",  # repaired
    "overlay.csv": "tenor,kind,notional,low,high,cost\n10,rates,20,0,0.3,0.0001\n"
    "15,zero-coupon,5,0,0.3,0.0001\n20,inflation,5,0,0.3,0.0001\n",
    "cohorts.csv": COHORTS,
    "flows.csv": "year,amount\n1,40\n2,45\n15,400\n",
    "mortality.csv": "sex,age,q\n"
    + "".join(
        f"{sex},{age},{min(1.0, 0.001 * 1.1 ** (age - 50)):.6g}\n"
        for sex in ("male", "female")
        for age in range(50, 121)
    ),
    "by_age.csv": "sex,age,value\nmale,0,0.9\nmale,70,1\nfemale,0,1\n",
    "improvement.csv": "sex,age,value\nmale,0,0.01\nfemale,0,0.012\n",
    "loadings.csv": "sex,age,loading\nmale,0,0.02\nfemale,0,0.015\n",
    "recovery.csv": "date,amount\n2025-12-31,5\n2026-12-31,6\n",
    "agreed.csv": "year,amount\n0.5,5\n",
    "allocation.csv": "age,protection,exposure\n20,0.2,1.5\n60,0.8,0.7\n70,1,0.3\n",
    "stress.csv": "scenario,input,label,kind,size\n"
    "Down,curve,1,multiply,-0.5\nDown,curve,20,multiply,-0.2\nDown,break_even,,add,0.001\n"
    "Down,price,equity,multiply,-0.3\nDown,credit_spread,,multiply,1\n",
}


def scenarios(seed: int, paths: int) -> str:
    """Ready-made paths of two years."""
    draw = np.random.default_rng(seed).normal
    head = ["path", "year", *(f"return {name}" for name in NAMES), "inflation", "wage"]
    rows = [",".join([*head, "zero 1", "zero 20"])]
    for path in range(1, paths + 1):
        for year in (1, 2):
            returns = draw(0.03, 0.1, len(NAMES))
            levels = [0.02, 0.024, draw(0.02, 0.005), draw(0.025, 0.005)]
            rows.append(",".join(map(str, [path, year, *returns, *levels])))
    return "\n".join(rows) + "\n"


def written(folder: Path) -> Path:
    """The folder with all files that the cases name; returns the path of a case in it."""
    supplied = {"training.csv": scenarios(1, 80), "evaluation.csv": scenarios(2, 64)}
    supplied["logo.svg"] = '<svg xmlns="http://www.w3.org/2000/svg"/>'
    for name, text in (FILES | supplied).items():
        (folder / name).write_text(text.lstrip())
    return folder / "case.toml"


LIABILITIES = {"assets": 200.0, "valuation_date": datetime.date(2024, 12, 31)}
TRAINING: dict[str, Any] = {
    "steps": 2, "paths": 16, "learning_rate": 0.01, "warmup": 1, "temperature_start": 0.02,
    "temperature_end": 0.01, "average": 0.5, "validation_paths": 16, "validation_every": 1,
    "patience": 5, "starts": 1, "seed": 1, "decay": 0.1,
}  # fmt: skip
SHORT = TRAINING | {"window": 1, "clip": 10.0, "keep": 0.95, "exploration": 0.1}
AUTO = TRAINING | {"clip": "auto", "window": "auto", "keep": "auto", "spread": 1.0}
VALUED = {"paths": 64, "sensitivity_paths": 64, "scenarios": "pseudo-random"} | {
    "judge_paths": 64, "search_paths": 64, "selection_paths": 64,
}  # fmt: skip
TABLE = {"kind": "table", "file": "mortality.csv", "multiplier": "by_age.csv"}
FORMULA = {
    "kind": "gompertz-makeham", "year": 2017, "male": [-10.4, 0.096, 0.0002], "female": [-11.5, 0.105],
    "improvement": "improvement.csv", "multiplier": 0.95,
}  # fmt: skip
MARKET: dict[str, Any] = {
    "kind": "pension",
    "fund": LIABILITIES | {"years": 2, "step": "year", "currency": "GBP"},
    "curve": {"file": "zero.csv"},
    "rates": {"kind": "hull-white", "mean_reversion": 0.03, "volatility": 0.008},
    "inflation": {"break_evens": "break_evens.csv"},
    "assets": {"file": "assets.csv", "return_kind": "total", "mean_kind": "geometric"},
    "credit": {"file": "credit.csv"},
    "currencies": {"file": "currencies.csv"},
    "members": {"file": "cohorts.csv"},
    "mortality": TABLE,
    "policy": {"hidden": [4]},
    "training": AUTO,
    "evaluation": VALUED,
}
CASES: dict[str, dict[str, Any]] = {
    "everything": MARKET
    | {
        "title": "Everything at once",
        "fund": LIABILITIES | {"years": 1, "step": "month", "currency": "GBP"},
        "curve": {"file": "zero.csv", "measure": "P", "compounding": "annual"}
        | {"extrapolation": "ultimate", "ultimate": 0.03, "speed": 0.1},
        "rates": {"kind": "g2++", "mean_reversion": [0.03, 0.4]}
        | {"volatility": ["rates.csv", 0.005], "price_of_risk": [-0.1, 0.05]},
        "inflation": {"break_evens": "forward_prices.csv", "compounding": "continuous"}
        | {"extrapolation": "ultimate", "ultimate": 0.02, "speed": 0.2, "mean_reversion": 0.3}
        | {"volatility": "rates.csv", "price_of_risk": 0.01, "index_volatility": "rates.csv"}
        | {"index_price_of_risk": 0.01, "real_wage_growth": 0.004, "wage_volatility": 0.01},
        "correlations": {"file": "correlations.csv", "repair": True},
        "overlay": {"file": "overlay.csv", "unit": "assets", "leverage": 0.5}
        | {"collateral_stress": 0.03},
        "mortality": TABLE | {"improvement": 0.01},
        "lee_carter": {"volatility": 0.6, "file": "loadings.csv"},
        "plan": {"timing": "arrears", "age_basis": "nearest", "fractional_ages": "constant-force"}
        | {"retirement_age": 67.0, "accruing": True, "open": False, "max_service": 40.0}
        | {"accrual_rate": 0.02, "offset": 5.0, "spouse_share": 0.7, "married_share": 0.6}
        | {"spouse_age_gap": 3, "expenses": 1.0}
        | {
            "indexation": {"kind": "conditional", "month": 7, "averaging": 6, "cap": 0.05}
            | {"floor": 0.0, "lower_ratio": 1.0, "upper_ratio": 1.3, "required_ratio": 1.0}
            | {"cut_years": 5},
            "contribution": {"kind": "spread", "normal_cost": "valuation", "loading": 0.05}
            | {"spread_factor": 0.1, "floor": 0.01, "cap": 0.9, "sponsor_limit": 100.0}
            | {"schedule": "agreed.csv"},
        },
        "liability": {"basis": "spread", "rate": 0.002, "future_indexation": "none"},
        "reconcile": {"liability": 300.0, "duration": 12.0, "tolerance": 0.9},
        "policy": {"hidden": [4], "observation": list(FEATURES)},
        "objective": [
            {"kind": "crra", "risk_aversion": 5.0, "wealth": 1.0, "output": "funding_ratio"}
            | {"weight": 1.0},
            {"kind": "mean", "output": "pv_contribution", "weight": -0.01},
            {"kind": "cvar", "level": 0.9},
            {"kind": "mean-variance", "risk_aversion": 0.1},
            {"kind": "target", "target": 1.1},
            {"kind": "entropic", "risk_aversion": 0.1},
        ],
        "sensitivity": {"held": ["asset_cost"]},
        "funding": {"rules": "uk", "technical_provisions": 0.01, "low_dependency": 0.005}
        | {"buy_out": -0.001, "recovery_years": 5.0},
        "regulation": {"rules": "dutch-ftk", "policy_ratios": [1.0, 1.01]}
        | {"insurance_risk": 0.03, "active_risk": 0.01},
        "stress": {"file": "stress.csv"},
        "frontier": {"points": 2, "steps": 1, "level": 0.9},
        "report": {
            "parts": [name for name in PARTS if name != "pots"],
            "title": "Fund",
            "author": "A. Actuary",
            "note": "For the board.",
            "logo": "logo.svg",
        },
    },
    "index-linked": MARKET
    | {
        "curve": {"file": "forward.csv", "measure": "Q", "compounding": "continuous"}
        | {"extrapolation": "flat-forward"},
        "inflation": {"break_evens": "break_evens.csv", "compounding": "annual"}
        | {"extrapolation": "flat-forward"},
        "assets": {"file": "assets.csv", "return_kind": "excess", "mean_kind": "arithmetic"}
        | {"turnover": 0.5},
        "overlay": {"file": "overlay.csv", "unit": "liability"},
        "mortality": FORMULA,
        "plan": {"timing": "advance", "age_basis": "exact", "fractional_ages": "uniform"}
        | {"open": True, "entry_age": 30.0, "accrual_rate": 0.02}
        | {
            "indexation": {"kind": "capped", "cap": 0.05, "floor": 0.0},
            "contribution": {"kind": "target", "target_ratio": 1.1, "recovery": "level"}
            | {"recovery_years": 8.0},
        },
        "liability": {"basis": "risk-free", "future_indexation": "capped"},
        "evaluation": VALUED | {"scenarios": "sobol"},
    },
    "increases apart": MARKET
    | {
        "plan": {"indexation": {"kind": "fixed", "rate": 0.03}}
        | {"revaluation": {"deferred": 0.025, "active": 0.01}},
        "liability": {"expense_loading": 0.03},
    },
    "career of salaries": MARKET
    | {
        "assets": {"file": "assets.csv", "return_kind": "total", "mean_kind": "log"},
        "plan": {"age_basis": "last", "accrual_rate": 0.02}
        | {
            "indexation": {"kind": "full"},
            "contribution": {"kind": "normal-cost", "normal_cost": "rate", "rate": 0.2},
        },
        "liability": {"basis": "fixed", "rate": 0.03, "future_indexation": "full"},
        "objective": {"kind": "mean", "output": "shortfall_square", "weight": -1.0},
        "training": SHORT,
    },
    "cash flows": MARKET
    | {
        "curve": {"file": "swaps.csv", "extrapolation": "smith-wilson", "ultimate": 0.0345}
        | {"compounding": "annual", "last_liquid": 20.0, "convergence": 60.0},
        "members": {"cash_flows": "flows.csv", "normal_cost": 5.0, "salary": 50.0},
        "mortality": None,
        "plan": {
            "indexation": {"kind": "none"},
            "contribution": {"kind": "target", "recovery": "rolling", "recovery_years": 8.0}
            | {"cap": 0.5},
        },
    },
    "personal pots": MARKET
    | {
        "plan": {"indexation": {"kind": "none"}, "expenses": 1.0}
        | {"contribution": {"kind": "fixed", "rate": 0.2}},
        "pots": {"rules": "dutch-wtp", "allocation": "allocation.csv", "reserve": 0.05}
        | {"fill_contribution": 0.1, "fill_return": 0.1, "release": 0.2, "largest": 0.15},
        "objective": [
            {"kind": "crra", "risk_aversion": 5.0, "output": "pension"},
            {"kind": "mean", "output": "pension Pensioner", "weight": 0.1},
        ],
    },
    "ready-made scenarios": MARKET
    | {
        "rates": None,
        "scenarios": {"training": "training.csv", "evaluation": "evaluation.csv"},
        "plan": {"indexation": {"kind": "fixed", "rate": 0.025}}
        | {"contribution": {"kind": "none", "schedule": "recovery.csv"}},
    },
}
