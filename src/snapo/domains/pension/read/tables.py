"""The tables of a pension case as they stand in the TOML file, each key with its meaning.

The description of a key is the text that an error message quotes as allowed.
"""

import datetime
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.meaning import Only
from snapo.case.parts import PartNames, names_of_parts
from snapo.case.table import TITLE, CaseTable, NotNegative, Positive, Title


def _plain_day(value: Any) -> Any:
    # A TOML date with a time is a datetime, which Python counts as a date.
    if isinstance(value, datetime.datetime):
        raise ValueError("a date without a time")
    return value


Day = Annotated[datetime.date, pydantic.BeforeValidator(_plain_day)]
Name = Annotated[str, Field(min_length=1)]
Share = Annotated[float, Field(ge=0, le=1)]
YearlyRate = Annotated[float, Field(gt=-1, lt=1)]

DATE = "a date, YYYY-MM-DD"
RATE = "a number between -1 and 1, like 0.02 for 2 %"
MINIMUM = "a number of at least 0"
ABOVE = "a number above 0"
SHARE = "a number from 0 to 1"
STEPS = "or the name of a CSV file with columns from_year,value"
VOLATILITY = f"{MINIMUM}, {STEPS}"


COHORTS = Only(
    lambda tables: tables["members"].cash_flows is None or tables["members"].file is not None,
    "for cohorts of [members] file",
    lambda _: "a case of the actuary's own cash flows",
)
PROMISED = Only(
    lambda tables: "pots" not in tables,
    "for promised rights",
    lambda _: "a fund of personal pots",
)
NOT_FLAT = Only(
    lambda tables: tables["curve"].extrapolation != "flat-forward",
    'with extrapolation "ultimate" or "smith-wilson"',
)
ULTIMATE = Only(
    lambda tables: tables["inflation"].extrapolation == "ultimate",
    'with extrapolation "ultimate"',
)
SMITH_WILSON = Only(
    lambda tables: tables["curve"].extrapolation == "smith-wilson",
    'with extrapolation "smith-wilson"',
)
SOUGHT = Only(
    lambda tables: tables["curve"].speed is None, "where no speed is stated that settles it"
)


def csv(columns: str, default: Any = ...) -> Any:
    """A field that names a CSV beside the case."""
    return Field(default, description=f"the name of a CSV file with columns {columns}")


def one_of(*available: str, default: Any = ...) -> Any:
    """A field that takes one of a few words."""
    displayed = [f'"{item}"' for item in available]
    text = (
        displayed[0] if len(displayed) == 1 else f"{', '.join(displayed[:-1])} or {displayed[-1]}"
    )
    return Field(default, description=text)


class FundTable(CaseTable):
    """`[fund]`: the horizon, its steps and the money."""

    valuation_date: Day = Field(description=DATE)
    years: Annotated[int, Field(ge=1, le=60)] = Field(description="a whole number from 1 to 60")
    step: Literal["month", "year"] = one_of("month", "year", default="month")
    assets: Positive = Field(description="the market value of all assets, above 0")
    currency: Name = Field("EUR", description='a name such as "EUR"')


class CurveTable(CaseTable):
    """`[curve]`: the nominal curve, and the measure of the scenarios."""

    file: Name = csv("tenor,zero (or tenor,forward or tenor,swap)")
    measure: Literal["P", "Q"] = one_of("P", "Q", default="P")
    compounding: Literal["continuous", "annual"] = one_of(
        "continuous", "annual", default="continuous"
    )
    extrapolation: Literal["flat-forward", "ultimate", "smith-wilson"] = one_of(
        "flat-forward", "ultimate", "smith-wilson", default="flat-forward"
    )
    ultimate: YearlyRate | None = Field(None, description=RATE)
    speed: Annotated[Positive | None, NOT_FLAT] = Field(None, description=ABOVE)
    last_liquid: Positive | None = Field(None, description=f"a tenor in years, {ABOVE}")
    convergence: Annotated[Positive | None, SMITH_WILSON, SOUGHT] = Field(
        None, description=f"a term in years, {ABOVE}"
    )


class RatesTable(CaseTable):
    """`[rates]`: the model of the short rate; lists have one number per factor."""

    kind: Name = Field(description='the name of a model, such as "hull-white" or "g2++"')
    mean_reversion: Positive | list[Positive] = Field(
        description="a number above 0, or a list with one for each factor"
    )
    volatility: NotNegative | Name | list[NotNegative | Name] = Field(
        description=f"{VOLATILITY}; a list with one for each factor"
    )
    price_of_risk: float | list[float] = Field(
        0.0, description="a number, or a list with one for each factor"
    )


class InflationTable(CaseTable):
    """`[inflation]`: break-evens, expected inflation, prices and wages."""

    break_evens: Name = csv("tenor,rate (or tenor,forward)")
    compounding: Literal["continuous", "annual"] | None = Field(
        None, description='"continuous" or "annual", as in [curve] where left out'
    )
    extrapolation: Literal["flat-forward", "ultimate"] = one_of(
        "flat-forward", "ultimate", default="flat-forward"
    )
    ultimate: YearlyRate | None = Field(None, description=RATE)
    speed: Annotated[Positive, ULTIMATE] = Field(0.1, description=ABOVE)
    mean_reversion: Positive = Field(0.3, description=ABOVE)
    volatility: NotNegative | Name = Field(0.007, description=VOLATILITY)
    price_of_risk: float = Field(0.0, description="a number")
    index_volatility: NotNegative | Name = Field(0.01, description=VOLATILITY)
    index_price_of_risk: float = Field(0.0, description="a number")
    real_wage_growth: YearlyRate = Field(0.0, description=RATE)
    wage_volatility: NotNegative = Field(0.0, description=MINIMUM)


class AssetsTable(CaseTable):
    """`[assets]`: the classes, and the sense of their means."""

    file: Name = csv("name,kind,mean,volatility,weight,low,high and, where they apply, others")
    return_kind: Literal["excess", "total"] = one_of("excess", "total")
    mean_kind: Literal["geometric", "arithmetic", "log"] = one_of("geometric", "arithmetic", "log")
    turnover: Positive | None = Field(
        None, description=f"the largest share of the assets traded per year, {ABOVE}"
    )


class CreditTable(CaseTable):
    """`[credit]`"""

    file: Name = csv("rating,spread,mean_spread,mean_reversion,volatility,default_loss")


class CurrenciesTable(CaseTable):
    """`[currencies]`"""

    file: Name = csv("currency,market,volatility,premium,hedge_ratio,hedge_cost")


class CorrelationsTable(CaseTable):
    """`[correlations]`"""

    file: Name = Field(description="the name of a CSV file: a square matrix with names on top")
    repair: bool = Field(False, description="true or false")


class OverlayTable(CaseTable):
    """`[overlay]`: receiver swaps by tenor, at par unless their kind says otherwise."""

    file: Name = csv("tenor,kind,notional,low,high,cost")
    unit: Literal["assets", "liability"] = one_of("assets", "liability", default="assets")
    leverage: NotNegative = Field(1.0, description=MINIMUM)
    collateral_stress: NotNegative = Field(0.035, description="a rise in rates of at least 0")


class ScenariosTable(CaseTable):
    """`[scenarios]`: ready-made scenarios in place of the generator."""

    training: Name = Field(description="the name of a CSV file")
    evaluation: Name = Field(description="the name of another CSV file")


class PolicyTable(CaseTable):
    """`[policy]`: the observation, and the widths of the hidden layers."""

    observation: list[str] | None = Field(None, description="a list of names")
    hidden: Annotated[list[Annotated[int, Field(ge=1, le=1024)]], Field(max_length=4)] = Field(
        [32, 32], description="a list of widths, such as [32, 32]"
    )


class SensitivityTable(CaseTable):
    """`[sensitivity]`: the numbers that are held fixed."""

    held: list[str] = Field([], description="a list of names of inputs")


class FrontierTable(CaseTable):
    """`[frontier]`: contributions against the shortfall, from a sweep."""

    points: Annotated[int, Field(ge=2, le=20)] = Field(5, description="a whole number from 2 to 20")
    steps: Annotated[int, Field(ge=1)] = Field(60, description="a whole number, 1 or more")
    level: Annotated[float, Field(ge=0.5, le=0.99)] = Field(
        0.95, description="a number from 0.5 to 0.99"
    )


class StressTable(CaseTable):
    """`[stress]`: shocks for the table of the report."""

    file: Name = csv("scenario,input,label,kind,size")


class FundReportTable(CaseTable):
    """`[report]`: the parts of a run that are wanted."""

    parts: PartNames = names_of_parts("sensitivities")


class RegulationTable(CaseTable):
    """`[regulation]`: a regulator's rules, and what they ask for beside the balance sheet."""

    rules: Name = Field(description='"dutch-ftk", or the name of a TOML file of rules')
    policy_ratios: list[Positive] = Field(
        [], description="funding ratios at the ends of the last months, the newest last"
    )
    insurance_risk: Share = Field(0.0, description=f"a share of the liability, {SHARE}")
    active_risk: Share = Field(0.0, description=f"a share of the assets, {SHARE}")


class PotsTable(CaseTable):
    """`[pots]`: personal pots by cohort, with a solidarity reserve."""

    rules: Name = Field(description='"dutch-wtp", or the name of a TOML file of rules')
    allocation: Name = csv("age,protection,exposure")
    reserve: Share = Field(0.0, description=f"a share of the assets, {SHARE}")
    fill_contribution: Share = Field(0.0, description=f"a share of contributions, {SHARE}")
    fill_return: Share = Field(0.0, description=f"a share of a year's excess return, {SHARE}")
    release: Share = Field(0.2, description=f"a share of the reserve, {SHARE}")
    largest: Share | None = Field(None, description=f"a share of the assets, {SHARE}")


class FundingTable(CaseTable):
    """`[funding]`: the bases of a scheme of the United Kingdom, side by side."""

    rules: Name = Field(description='"uk", or the name of a TOML file of rules')
    technical_provisions: YearlyRate = Field(description=f"over gilts, {RATE}")
    low_dependency: YearlyRate | None = Field(None, description=f"over gilts, {RATE}")
    buy_out: YearlyRate = Field(description=f"over gilts, {RATE}")
    recovery_years: Positive | None = Field(None, description=ABOVE)


class PensionTable(CaseTable):
    """The whole file."""

    kind: Literal["pension"] = Field(description='"pension"')
    title: Title = Field("Pension fund", description=TITLE)
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
    mortality: Annotated[dict | None, COHORTS] = Field(None, description="the table [mortality]")
    lee_carter: Annotated[dict | None, COHORTS, PROMISED] = Field(
        None, description="the table [lee_carter]"
    )
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
    frontier: Annotated[dict | None, PROMISED] = Field(None, description="the table [frontier]")
    regulation: Annotated[dict | None, PROMISED] = Field(None, description="the table [regulation]")
    funding: Annotated[dict | None, PROMISED] = Field(None, description="the table [funding]")
    pots: dict | None = Field(None, description="the table [pots]")
    report: dict = Field({}, description="the table [report]")
    training: dict = Field({}, description="the table [training]")
    evaluation: dict = Field({}, description="the table [evaluation]")
