"""The tables of a case about people and rules, each key with its meaning; see `tables`."""

from typing import Annotated, Literal

from pydantic import Field

from snapo.case.table import Table

from .tables import (
    ABOVE,
    LEAST,
    RATE,
    SHARE,
    Name,
    NotNegative,
    Positive,
    Rate,
    Share,
    csv,
    words,
)


class MembersTable(Table):
    """`[members]`: cohorts, or the actuary's cash flows."""

    file: Name | None = csv("name,status,sex,age,number,pension,salary,service", None)
    cash_flows: Name | None = csv("year (or month),amount", None)
    normal_cost: NotNegative = Field(0.0, description="money per year, at least 0")
    salary: NotNegative = Field(0.0, description="money per year, at least 0")


class MortalityTable(Table):
    """`[mortality]`: death probabilities or a formula, with improvement and multipliers."""

    kind: Literal["table", "gompertz-makeham"] = words("table", "gompertz-makeham")
    file: Name | None = csv("sex,age,q", None)
    male: Annotated[list[float], Field(min_length=2, max_length=3)] | None = Field(
        None, description="[alpha, beta] or [alpha, beta, makeham]"
    )
    female: Annotated[list[float], Field(min_length=2, max_length=3)] | None = Field(
        None, description="[alpha, beta] or [alpha, beta, makeham]"
    )
    improvement: Rate | Name = Field(
        0.0, description="a number between -1 and 1, or a CSV file with columns sex,age,value"
    )
    multiplier: Positive | Name = Field(
        1.0, description="a number above 0, or a CSV file with columns sex,age,value"
    )


class LeeCarterTable(Table):
    """`[lee_carter]`: the stochastic factor of mortality."""

    volatility: NotNegative = Field(description=LEAST)
    file: Name = csv("sex,age,loading")


class PlanTable(Table):
    """`[plan]`: benefits, and the two tables below it."""

    timing: Literal["advance", "arrears"] = words("advance", "arrears", default="arrears")
    age_basis: Literal["nearest", "last", "exact"] = words(
        "nearest", "last", "exact", default="nearest"
    )
    fractional_ages: Literal["constant-force", "uniform"] = words(
        "constant-force", "uniform", default="constant-force"
    )
    retirement_age: Annotated[float, Field(ge=40, le=90)] = Field(
        67.0, description="an age from 40 to 90"
    )
    accruing: bool = Field(True, description="true or false")
    open: bool = Field(False, description="true or false")
    entry_age: Annotated[float, Field(ge=15, le=90)] = Field(
        25.0, description="an age from 15 to 90"
    )
    max_service: Positive = Field(60.0, description="a number of years above 0")
    accrual_rate: Share = Field(0.0, description=SHARE)
    offset: NotNegative = Field(0.0, description="money per year, at least 0")
    spouse_share: Share = Field(0.0, description=SHARE)
    married_share: Share = Field(1.0, description=SHARE)
    spouse_age_gap: Annotated[int, Field(ge=-20, le=20)] = Field(
        3, description="a whole number from -20 to 20"
    )
    expenses: NotNegative = Field(0.0, description="money per year, at least 0")
    indexation: dict = Field({}, description="the table [plan.indexation]")
    contribution: dict = Field({}, description="the table [plan.contribution]")


class IndexationTable(Table):
    """`[plan.indexation]`"""

    kind: Literal["none", "fixed", "full", "capped", "conditional"] = words(
        "none", "fixed", "full", "capped", "conditional", default="none"
    )
    rate: Rate | None = Field(None, description=RATE)
    month: Annotated[int, Field(ge=1, le=12)] = Field(1, description="a month, 1 to 12")
    averaging: Annotated[int, Field(ge=1, le=12)] = Field(
        12, description="a whole number of months, 1 to 12"
    )
    cap: Rate = Field(0.5, description=RATE)
    floor: Rate = Field(-0.5, description=RATE)
    lower_ratio: NotNegative = Field(1.1, description=LEAST)
    upper_ratio: NotNegative = Field(1.3, description=LEAST)
    required_ratio: NotNegative = Field(1.0, description=LEAST)
    cut_years: Annotated[int, Field(ge=0, le=50)] = Field(
        0, description="a whole number from 0 to 50"
    )


class ContributionTable(Table):
    """`[plan.contribution]`"""

    kind: Literal["none", "fixed", "normal-cost", "spread", "target"] = words(
        "none", "fixed", "normal-cost", "spread", "target", default="none"
    )
    normal_cost: Literal["valuation", "rate"] = words("valuation", "rate", default="valuation")
    rate: NotNegative | None = Field(None, description=f"a share of salaries, {LEAST}")
    loading: Annotated[float, Field(ge=-1)] = Field(0.0, description="a number of at least -1")
    spread_factor: NotNegative | None = Field(None, description=f"per year, {LEAST}")
    target_ratio: Positive = Field(1.0, description=ABOVE)
    recovery_years: Positive = Field(10.0, description=ABOVE)
    floor: float | None = Field(None, description="a share of salaries")
    cap: float | None = Field(None, description="a share of salaries")
    sponsor_limit: NotNegative | None = Field(None, description="money per year, at least 0")
    schedule: Name | None = csv("date,amount (or year,amount)", None)


class LiabilityTable(Table):
    """`[liability]`"""

    basis: Literal["risk-free", "spread", "fixed"] = words(
        "risk-free", "spread", "fixed", default="risk-free"
    )
    rate: Rate | None = Field(None, description=RATE)
    future_indexation: Literal["none", "full", "capped"] = words(
        "none", "full", "capped", default="none"
    )


class ReconcileTable(Table):
    """`[reconcile]`: the actuary's own figures."""

    liability: Positive | None = Field(None, description=ABOVE)
    duration: Positive | None = Field(None, description=ABOVE)
    tolerance: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.001, description="a number above 0 and below 1"
    )
