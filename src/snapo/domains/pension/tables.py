"""The tables of a pension case as they stand in the TOML file, each key with its meaning.

The description of a key is the text that an error message quotes as what is allowed.
"""

import datetime
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.table import Table


def _plain_day(value: Any) -> Any:
    # A TOML date with a time is a datetime, which Python counts as a date.
    if isinstance(value, datetime.datetime):
        raise ValueError("a date without a time")
    return value


Day = Annotated[datetime.date, pydantic.BeforeValidator(_plain_day)]
Name = Annotated[str, Field(min_length=1)]
NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Rate = Annotated[float, Field(gt=-1, lt=1)]

DATE = "a date, YYYY-MM-DD"
RATE = "a number between -1 and 1, like 0.02 for 2 %"
LEAST = "a number of at least 0"
ABOVE = "a number above 0"
SHARE = "a number from 0 to 1"
STEPS = "or the name of a CSV file with columns from_year,value"
VOLATILITY = f"{LEAST}, {STEPS}"


def csv(columns: str, default: Any = ...) -> Any:
    """A field that names a CSV beside the case."""
    return Field(default, description=f"the name of a CSV file with columns {columns}")


def words(*known: str, default: Any = ...) -> Any:
    """A field that takes one of a few words."""
    shown = [f'"{each}"' for each in known]
    text = shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} or {shown[-1]}"
    return Field(default, description=text)


class FundTable(Table):
    """`[fund]`: what is simulated."""

    valuation_date: Day = Field(description=DATE)
    years: Annotated[int, Field(ge=1, le=60)] = Field(description="a whole number from 1 to 60")
    step: Literal["month", "year"] = words("month", "year", default="month")
    assets: Positive = Field(description="the market value of all assets, above 0")
    currency: Name = Field("EUR", description='a name such as "EUR"')


class CurveTable(Table):
    """`[curve]`: the nominal curve, and the measure of the scenarios."""

    file: Name = csv("tenor,zero (or tenor,forward)")
    measure: Literal["P", "Q"] = words("P", "Q", default="P")
    compounding: Literal["continuous", "annual"] = words(
        "continuous", "annual", default="continuous"
    )
    extrapolation: Literal["flat-forward", "ultimate"] = words(
        "flat-forward", "ultimate", default="flat-forward"
    )
    ultimate: Rate | None = Field(None, description=RATE)
    speed: Positive = Field(0.1, description=ABOVE)


class RatesTable(Table):
    """`[rates]`: the model of the short rate; lists have one number per factor."""

    kind: Literal["hull-white", "g2++"] = words("hull-white", "g2++")
    mean_reversion: Positive | Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        description="a number above 0, or a list of two for g2++"
    )
    volatility: NotNegative | Name | list[NotNegative | Name] = Field(
        description=f"{VOLATILITY}; a list of two for g2++"
    )
    price_of_risk: float | list[float] = Field(
        0.0, description="a number, or a list of two for g2++"
    )


class InflationTable(Table):
    """`[inflation]`: break-evens, expected inflation, prices and wages."""

    break_evens: Name = csv("tenor,rate (or tenor,forward)")
    compounding: Literal["continuous", "annual"] = words(
        "continuous", "annual", default="continuous"
    )
    extrapolation: Literal["flat-forward", "ultimate"] = words(
        "flat-forward", "ultimate", default="flat-forward"
    )
    ultimate: Rate | None = Field(None, description=RATE)
    speed: Positive = Field(0.1, description=ABOVE)
    mean_reversion: Positive = Field(0.3, description=ABOVE)
    volatility: NotNegative | Name = Field(0.007, description=VOLATILITY)
    price_of_risk: float = Field(0.0, description="a number")
    index_volatility: NotNegative | Name = Field(0.01, description=VOLATILITY)
    index_price_of_risk: float = Field(0.0, description="a number")
    real_wage_growth: Rate = Field(0.0, description=RATE)
    wage_volatility: NotNegative = Field(0.0, description=LEAST)


class AssetsTable(Table):
    """`[assets]`: the classes and how their means are meant."""

    file: Name = csv("name,kind,mean,volatility,weight,low,high and, where they apply, others")
    return_kind: Literal["excess", "total"] = words("excess", "total")
    mean_kind: Literal["geometric", "arithmetic", "log"] = words("geometric", "arithmetic", "log")


class CreditTable(Table):
    """`[credit]`"""

    file: Name = csv("rating,spread,mean_spread,mean_reversion,volatility,default_loss")


class CurrenciesTable(Table):
    """`[currencies]`"""

    file: Name = csv("currency,volatility,premium,hedge_ratio,hedge_cost")


class CorrelationsTable(Table):
    """`[correlations]`"""

    file: Name = Field(description="the name of a CSV file: a square matrix with names on top")
    repair: bool = Field(False, description="true or false")


class OverlayTable(Table):
    """`[overlay]`: receiver swaps by tenor."""

    file: Name = csv("tenor,notional,low,high,cost")
    unit: Literal["assets", "liability"] = words("assets", "liability", default="assets")
    leverage: NotNegative = Field(1.0, description=LEAST)
    collateral_stress: NotNegative = Field(0.035, description="a rise in rates of at least 0")


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

    kind: Literal["none", "full", "capped", "conditional"] = words(
        "none", "full", "capped", "conditional", default="none"
    )
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


class LiabilityTable(Table):
    """`[liability]`"""

    basis: Literal["risk-free", "spread", "fixed"] = words(
        "risk-free", "spread", "fixed", default="risk-free"
    )
    rate: Rate | None = Field(None, description=RATE)
    future_indexation: Literal["none", "full"] = words("none", "full", default="none")


class ReconcileTable(Table):
    """`[reconcile]`: the actuary's own figures."""

    liability: Positive | None = Field(None, description=ABOVE)
    duration: Positive | None = Field(None, description=ABOVE)
    tolerance: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.001, description="a number above 0 and below 1"
    )


class ScenariosTable(Table):
    """`[scenarios]`: ready-made scenarios in place of the generator."""

    training: Name = Field(description="the name of a CSV file")
    evaluation: Name = Field(description="the name of another CSV file")


class PolicyTable(Table):
    """`[policy]`: what the policy sees, and the widths of its hidden layers."""

    observation: list[str] | None = Field(None, description="a list of names")
    hidden: Annotated[list[Annotated[int, Field(ge=1, le=1024)]], Field(max_length=4)] = Field(
        [32, 32], description="a list of widths, such as [32, 32]"
    )


class SensitivityTable(Table):
    """`[sensitivity]`: the numbers that are held fixed."""

    held: list[str] = Field([], description="a list of names of inputs")


class FrontierTable(Table):
    """`[frontier]`: contributions against the shortfall, from a sweep."""

    points: Annotated[int, Field(ge=2, le=20)] = Field(5, description="a whole number from 2 to 20")
    steps: Annotated[int, Field(ge=1)] = Field(60, description="a whole number, 1 or more")
    level: Annotated[float, Field(ge=0.5, le=0.99)] = Field(
        0.95, description="a number from 0.5 to 0.99"
    )


class StressTable(Table):
    """`[stress]`: shocks for the table of the report."""

    file: Name = csv("scenario,input,label,kind,size")


class PensionTable(Table):
    """The whole file."""

    kind: Literal["pension"] = Field(description='"pension"')
    title: str = Field("Pension fund", description="a text in quotation marks")
    fund: dict = Field(description="the table [fund]")
    curve: dict = Field(description="the table [curve]")
    rates: dict | None = Field(None, description="the table [rates]")
    inflation: dict = Field(description="the table [inflation]")
    assets: dict = Field(description="the table [assets]")
    credit: dict | None = Field(None, description="the table [credit]")
    currencies: dict | None = Field(None, description="the table [currencies]")
    correlations: dict | None = Field(None, description="the table [correlations]")
    overlay: dict | None = Field(None, description="the table [overlay]")
    members: dict = Field(description="the table [members]")
    mortality: dict | None = Field(None, description="the table [mortality]")
    lee_carter: dict | None = Field(None, description="the table [lee_carter]")
    plan: dict = Field({}, description="the table [plan]")
    liability: dict = Field({}, description="the table [liability]")
    reconcile: dict | None = Field(None, description="the table [reconcile]")
    scenarios: dict | None = Field(None, description="the table [scenarios]")
    policy: dict = Field({}, description="the table [policy]")
    objective: dict | list = Field(
        {}, description="the table [objective], or several [[objective]]"
    )
    sensitivity: dict = Field({}, description="the table [sensitivity]")
    stress: dict | None = Field(None, description="the table [stress]")
    frontier: dict | None = Field(None, description="the table [frontier]")
    training: dict = Field({}, description="the table [training]")
    evaluation: dict = Field({}, description="the table [evaluation]")
