"""The tables of a pension case of the TOML file, each key with its meaning.

The description of a key is the text that an error message quotes as allowed.
"""

import datetime
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.meaning import Only
from snapo.case.parts import PartNames, names_of_parts
from snapo.case.quantity import FRACTION, NOT_NEGATIVE, POSITIVE, Range
from snapo.case.report import ReportTable
from snapo.case.table import TITLE, CaseTable, Nonempty, Title

from ..quantities import (
    AMOUNT,
    FROM_YEAR,
    NUMBER,
    QUIET_VOLATILITY,
    RATE,
    SHARE,
    SQUARE_ROOT,
    YEARLY,
    YEARLY_RATE,
    plain,
)


def _plain_day(value: Any) -> Any:
    # A TOML date with a time is a datetime, which Python counts as a date.
    if isinstance(value, datetime.datetime):
        raise ValueError("a date without a time")
    return value


ValuationDate = Annotated[datetime.date, pydantic.BeforeValidator(_plain_day)]
HiddenLayers = Annotated[list[Annotated[int, Field(ge=1, le=1024)]], Field(max_length=4)]
Ratio = Annotated[float, Field(gt=0)]
DATE, WHOLE = "a date, YYYY-MM-DD", "a whole number"
OF_FACTOR = "of a factor of the short rate; the curve is fitted again"
OF_INFLATION = "of expected inflation; break-evens are fitted again"
MOVING = QUIET_VOLATILITY.of("volatility", by=FROM_YEAR)
REVERSION = NUMBER.of("model", unit=YEARLY, range=POSITIVE)
PRICE_OF_RISK = NUMBER.of("premium", unit=SQUARE_ROOT)
FAR_OUT = "the forward rate far beyond the last node"
RESERVE = SHARE.of("plan")
OF_RESERVE = "the solidarity reserve: its size, its filling or its release"
SWAP_LIMIT, A_LIMIT = SHARE.of("overlay"), "a limit of the swaps"
OVER_GILTS = YEARLY_RATE._replace(noun="a rate over gilts")


def _share_of(text: str) -> Range:
    return FRACTION._replace(noun=f"a share of {text}")


def _above(text: str) -> Range:
    return POSITIVE._replace(noun=text)


COHORTS = Only(
    lambda tables: tables["members"].cash_flows is None or tables["members"].file is not None,
    "for cohorts of [members] file",
    lambda _: "a case with cash flows of the actuary",
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
SOUGHT = Only(lambda tables: tables["curve"].speed is None, "if no speed is specified")


def csv(columns: str, default: Any = ...) -> Any:
    """A field that names a CSV next to the case."""
    return Field(default, description=f"the name of a CSV file with columns {columns}")


def one_of(*available: str, default: Any = ...) -> Any:
    """A field that takes one of a few names."""
    displayed = [f'"{item}"' for item in available]
    text = (
        displayed[0] if len(displayed) == 1 else f"{', '.join(displayed[:-1])} or {displayed[-1]}"
    )
    return Field(default, description=text)


class FundTable(CaseTable):
    """`[fund]`: the horizon, its steps and the money."""

    valuation_date: ValuationDate = Field(description=DATE)
    years: int = plain(Range(1, 60, noun=WHOLE))
    step: Literal["month", "year"] = one_of("month", "year", default="month")
    currency: Nonempty = Field("EUR", description='a name such as "EUR"')
    assets: CaseInput = AMOUNT(
        "the market value of all assets today",
        unit="{currency}", range=_above("the market value of all assets,"), group="assets",
    )  # fmt: skip


class CurveTable(CaseTable):
    """`[curve]`: the nominal curve, and the measure of the scenarios."""

    file: Nonempty = csv("tenor,zero (or tenor,forward or tenor,swap)")
    measure: Literal["P", "Q"] = one_of("P", "Q", default="P")
    compounding: Literal["continuous", "annual"] = one_of(
        "continuous", "annual", default="continuous"
    )
    extrapolation: Literal["flat-forward", "ultimate", "smith-wilson"] = one_of(
        "flat-forward", "ultimate", "smith-wilson", default="flat-forward"
    )
    ultimate: CaseInput | None = RATE(FAR_OUT, None, group="model", name="ultimate_forward")
    speed: Annotated[float | None, NOT_FLAT] = plain(POSITIVE, None)
    last_liquid: float | None = plain(_above("a tenor in years"), None)
    convergence: Annotated[float | None, SMITH_WILSON, SOUGHT] = plain(
        _above("a term in years"), None
    )


class RatesTable(CaseTable):
    """`[rates]`: the model of the short rate; lists have one number per factor."""

    kind: Nonempty = Field(description='the name of a model, such as "hull-white" or "g2++"')
    mean_reversion: tuple[CaseInput, ...] = REVERSION(f"mean reversion {OF_FACTOR}", by_factor=True)
    volatility: tuple[CaseInput, ...] = MOVING(f"volatility {OF_FACTOR}", by_factor=True)
    price_of_risk: tuple[CaseInput, ...] = PRICE_OF_RISK(
        "held while the curve moves; higher is a lower premium of long bonds", 0.0, by_factor=True
    )


class InflationTable(CaseTable):
    """`[inflation]`: break-evens, expected inflation, prices and wages."""

    break_evens: Nonempty = csv("tenor,rate (or tenor,forward)")
    compounding: Literal["continuous", "annual"] | None = Field(
        None, description='"continuous" or "annual", by default as in [curve]'
    )
    extrapolation: Literal["flat-forward", "ultimate"] = one_of(
        "flat-forward", "ultimate", default="flat-forward"
    )
    ultimate: CaseInput | None = RATE(FAR_OUT, None, group="model", name="ultimate_break_even")
    speed: Annotated[float, ULTIMATE] = plain(POSITIVE, 0.1)
    mean_reversion: CaseInput = REVERSION(
        f"mean reversion {OF_INFLATION}", 0.3, name="inflation_mean_reversion"
    )
    volatility: CaseInput = MOVING(f"volatility {OF_INFLATION}", 0.007, name="inflation_volatility")
    price_of_risk: CaseInput = PRICE_OF_RISK(
        f"price of the risk {OF_INFLATION}", 0.0, name="inflation_price_of_risk"
    )
    index_volatility: CaseInput = MOVING("volatility of realised prices", 0.01)
    index_price_of_risk: CaseInput = PRICE_OF_RISK("price of the risk of realised prices", 0.0)
    real_wage_growth: CaseInput = RATE("growth of wages over prices", 0.0, group="model")
    wage_volatility: CaseInput = QUIET_VOLATILITY("volatility of wages over prices", 0.0)


class AssetsTable(CaseTable):
    """`[assets]`: the classes, and the meaning of their mean returns."""

    file: Nonempty = csv("name,kind,mean,volatility,weight,low,high and, where they apply, others")
    return_kind: Literal["excess", "total"] = one_of("excess", "total")
    mean_kind: Literal["geometric", "arithmetic", "log"] = one_of("geometric", "arithmetic", "log")
    turnover: float | None = plain(_above("the largest share of the assets traded per year,"), None)


class CreditTable(CaseTable):
    """`[credit]`"""

    file: Nonempty = csv("rating,spread,mean_spread,mean_reversion,volatility,default_loss")


class CurrenciesTable(CaseTable):
    """`[currencies]`"""

    file: Nonempty = csv("currency,market,volatility,premium,hedge_ratio,hedge_cost")


class CorrelationsTable(CaseTable):
    """`[correlations]`"""

    file: Nonempty = Field(
        description="the name of a CSV file: a square matrix with names in the first row"
    )
    repair: bool = Field(False, description="true or false")


class OverlayTable(CaseTable):
    """`[overlay]`: receiver swaps by tenor, at par unless their kind is another."""

    file: Nonempty = csv("tenor,kind,notional,low,high,cost")
    unit: Literal["assets", "liability"] = one_of("assets", "liability", default="assets")
    leverage: CaseInput = SWAP_LIMIT(A_LIMIT, 1.0, range=NOT_NEGATIVE)
    collateral_stress: CaseInput = SWAP_LIMIT(
        A_LIMIT, 0.035, unit=YEARLY, range=Range(0.0, noun="a rise in rates")
    )


class ScenariosTable(CaseTable):
    """`[scenarios]`: ready-made scenarios instead of the generator."""

    training: Nonempty = Field(description="the name of a CSV file")
    evaluation: Nonempty = Field(description="the name of another CSV file")


class PolicyTable(CaseTable):
    """`[policy]`: the observation, and the widths of the hidden layers."""

    observation: list[str] | None = Field(None, description="a list of names")
    hidden: HiddenLayers = Field([32, 32], description="a list of widths, such as [32, 32]")


class SensitivityTable(CaseTable):
    """`[sensitivity]`: the numbers that are held fixed."""

    held: list[str] = Field([], description="a list of names of inputs")


class FrontierTable(CaseTable):
    """`[frontier]`: contributions against the shortfall, from a sweep."""

    points: int = plain(Range(2, 20, noun=WHOLE), 5)
    steps: int = plain(Range(1, noun=WHOLE), 60)
    level: float = plain(Range(0.5, 0.99), 0.95)


class StressTable(CaseTable):
    """`[stress]`: shocks for the table of the report."""

    file: Nonempty = csv("scenario,input,label,kind,size")


class FundReportTable(ReportTable):
    """`[report]`: the parts of a run that are wanted, and texts of its page."""

    parts: PartNames = names_of_parts("sensitivities")


class RegulationTable(CaseTable):
    """`[regulation]`: a regulator's rules, and the figures they ask for."""

    rules: Nonempty = Field(description='"dutch-ftk", or the name of a TOML file of rules')
    policy_ratios: list[Ratio] = Field(
        [], description="funding ratios at the ends of the last months, the newest last"
    )
    insurance_risk: float = plain(_share_of("the liability"), 0.0)
    active_risk: float = plain(_share_of("the assets"), 0.0)


class PotsTable(CaseTable):
    """`[pots]`: personal pots by cohort, with a solidarity reserve."""

    rules: Nonempty = Field(description='"dutch-wtp", or the name of a TOML file of rules')
    allocation: Nonempty = csv("age,protection,exposure")
    reserve: CaseInput = RESERVE(
        OF_RESERVE, 0.0, range=_share_of("the assets"), name="reserve_today"
    )
    fill_contribution: CaseInput = RESERVE(OF_RESERVE, 0.0, range=_share_of("contributions"))
    fill_return: CaseInput = RESERVE(OF_RESERVE, 0.0, range=_share_of("a year's excess return"))
    release: CaseInput = RESERVE(OF_RESERVE, 0.2, range=_share_of("the reserve"))
    largest: CaseInput | None = RESERVE(OF_RESERVE, None, range=_share_of("the assets"))


class FundingTable(CaseTable):
    """`[funding]`: the bases of a scheme of the United Kingdom, side by side."""

    rules: Nonempty = Field(description='"uk", or the name of a TOML file of rules')
    technical_provisions: float = plain(OVER_GILTS)
    low_dependency: float | None = plain(OVER_GILTS, None)
    buy_out: float = plain(OVER_GILTS)
    recovery_years: float | None = plain(POSITIVE, None)


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
