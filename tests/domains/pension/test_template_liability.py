"""The liability of the small example against a sum over people in plain NumPy, from its files."""

import csv

import numpy as np
import pytest
from tests.domains.pension.miniature import TEMPLATES

from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain

SMALL = TEMPLATES / "small"
YEARS = 8.0  # of improvement: a table of 2017, valued as 2025 begins
MONTHS = 1200


def rows(name):
    lines = [line for line in (SMALL / name).read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def survival(sex, age):
    """To be alive after each month: q times the multiplier, improved by 1.2 % a year from 2017."""
    table = {(r["sex"], int(r["age"])): float(r["q"]) for r in rows("mortality.csv")}
    factor = {r["sex"]: float(r["value"]) for r in rows("multipliers.csv")}
    hazards = []
    for year in range(MONTHS // 12):
        q = factor[sex] * table[sex, min(age + year, 119)]
        hazards += [-np.log(1 - q) * np.exp(-0.012 * (YEARS + year)) / 12] * 12
    return np.exp(-np.cumsum(hazards))


def test_the_small_example_s_liability_is_that_of_its_files():
    nodes = rows("curve.csv")
    tenor, zero = (np.array([float(r[key]) for r in nodes]) for key in ("tenor", "zero"))
    time = np.arange(1, MONTHS + 1) / 12
    last = (zero[-1] * tenor[-1] - zero[-2] * tenor[-2]) / (tenor[-1] - tenor[-2])
    grown = np.interp(time, tenor, zero) * np.minimum(time, tenor[-1])
    grown += last * np.maximum(time - tenor[-1], 0.0)
    discount = np.exp(-grown - 0.002 * time)
    flow = np.zeros(MONTHS)
    for row in rows("cohorts.csv"):
        sex, age = row["sex"], int(row["age"])
        paid = float(row["number"]) * float(row["pension"]) / 12
        own = survival(sex, age)
        waits = row["status"] in ("active", "deferred")
        flow += paid * own * ((age + np.arange(MONTHS) / 12 >= 67 - 1e-9) | (not waits))
        if row["status"] != "spouse":
            other, gap = ("female", -3) if sex == "male" else ("male", 3)
            flow += paid * 0.7 * 0.65 * (1 - own) * survival(other, age + gap)
    case = read_case(SMALL)
    found = figures(case, plain(pension_inputs(case)))
    assert found.cash_flow == pytest.approx(flow, rel=1e-9, abs=1e-3)
    assert found.liability == pytest.approx(flow @ discount, rel=1e-9)
    assert case.reconcile is not None
    assert case.reconcile.liability == pytest.approx(flow @ discount, rel=1e-8)
    assert case.reconcile.duration == pytest.approx(
        flow @ (discount * time) / (flow @ discount), abs=0.005
    )
