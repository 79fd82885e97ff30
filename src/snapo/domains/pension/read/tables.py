"""The tables in the TOML file of a pension case, with the meaning and the allowed values of every
key. Error messages quote these texts.
"""

import datetime
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from snapo.case.given import CaseInput
from snapo.case.meaning import Only
from snapo.case.parts import PartNames, names_of_parts
from snapo.case.quantity import FRACTION, NOT_NEGATIVE, POSITIVE, Range
from snapo.case.report import ReportKey, ReportTable
from snapo.case.settings import EvaluationKey, TrainingKey
from snapo.case.table import CaseTable, Nonempty, Title, doc, subtable

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
OF_FACTOR = "of a factor of the short rate; the model is fitted to the curve again"
OF_INFLATION = "of expected inflation; the model is fitted to the break-evens again"
MOVING = QUIET_VOLATILITY.of("volatility", by=FROM_YEAR)
REVERSION = NUMBER.of("model", unit=YEARLY, range=POSITIVE)
PRICE_OF_RISK = NUMBER.of("premium", unit=SQUARE_ROOT)
FAR_OUT = "the forward rate far beyond the last node"
RESERVE = SHARE.of("plan")

SWAP_LIMIT = SHARE.of("overlay")
OVER_GILTS = YEARLY_RATE._replace(noun="a margin over gilts")


def _share_of(text: str) -> Range:
    return FRACTION._replace(noun=f"a share of {text}")


def _above(text: str) -> Range:
    return POSITIVE._replace(noun=text)


COHORTS = Only(
    lambda tables: tables["members"].cash_flows is None or tables["members"].file is not None,
    "for cohorts, which members.file names",
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


def csv(meaning: str, columns: str, default: Any = ...) -> Any:
    """A field that names a CSV next to the case."""
    return doc(meaning, default, f"the name of a CSV file with columns {columns}")


class FundTable(CaseTable):
    """`[fund]`: the horizon, its steps and the money."""

    valuation_date: ValuationDate = doc("date of today's assets, prices and rights", allowed=DATE)
    years: int = plain("horizon of the decisions, in years", Range(1, 60, noun=WHOLE))
    step: Literal["month", "year"] = doc("time from one decision to the next", "month")
    currency: Nonempty = doc("currency of all money", "EUR", 'a name such as "EUR"')
    assets: CaseInput = AMOUNT(
        "the market value of all assets today",
        unit="{currency}", range=_above("the market value of all assets,"), group="assets",
    )  # fmt: skip


class CurveTable(CaseTable):
    """`[curve]`: the nominal curve, and the measure of the scenarios."""

    file: Nonempty = csv(
        "rates of the nominal curve, by tenor in years",
        "tenor,zero (or tenor,forward or tenor,swap)",
    )
    measure: Literal["P", "Q"] = doc("measure of the scenarios, real-world or risk-neutral", "P")
    compounding: Literal["continuous", "annual"] = doc("compounding of all rates", "continuous")
    extrapolation: Literal["flat-forward", "ultimate", "smith-wilson"] = doc(
        "curve beyond the last node", "flat-forward"
    )
    ultimate: CaseInput | None = RATE(FAR_OUT, None, group="model", name="ultimate_forward")
    speed: Annotated[float | None, NOT_FLAT] = plain(
        "speed of convergence to the ultimate rate, in 1/year", POSITIVE, None
    )
    last_liquid: float | None = plain(
        "tenor up to which Smith-Wilson uses quotes", _above("a tenor in years"), None
    )
    convergence: Annotated[float | None, SMITH_WILSON, SOUGHT] = plain(
        "term at which the forward rate is within a basis point of the ultimate one",
        _above("a term in years"),
        None,
    )


class RatesTable(CaseTable):
    """`[rates]`: the model of the short rate; lists have one number per factor."""

    kind: Nonempty = doc(
        "model of the short rate", allowed='the name of a model, such as "hull-white" or "g2++"'
    )
    mean_reversion: tuple[CaseInput, ...] = REVERSION(f"mean reversion {OF_FACTOR}", by_factor=True)
    volatility: tuple[CaseInput, ...] = MOVING(f"volatility {OF_FACTOR}", by_factor=True)
    price_of_risk: tuple[CaseInput, ...] = PRICE_OF_RISK(
        "price of interest rate risk; a higher number means a lower premium of long bonds",
        0.0,
        by_factor=True,
    )


class InflationTable(CaseTable):
    """`[inflation]`: break-evens, expected inflation, prices and wages."""

    break_evens: Nonempty = csv("break-evens, by tenor in years", "tenor,rate (or tenor,forward)")
    compounding: Literal["continuous", "annual"] | None = doc(
        "compounding of the break-evens", None, '"continuous" or "annual", by default as in [curve]'
    )
    extrapolation: Literal["flat-forward", "ultimate"] = doc(
        "curve beyond the last node", "flat-forward"
    )
    ultimate: CaseInput | None = RATE(FAR_OUT, None, group="model", name="ultimate_break_even")
    speed: Annotated[float, ULTIMATE] = plain(
        "speed of convergence to the ultimate rate, in 1/year", POSITIVE, 0.1
    )
    mean_reversion: CaseInput = REVERSION(
        f"mean reversion {OF_INFLATION}", 0.3, name="inflation_mean_reversion"
    )
    volatility: CaseInput = MOVING(f"volatility {OF_INFLATION}", 0.007, name="inflation_volatility")
    price_of_risk: CaseInput = PRICE_OF_RISK(
        "price of the risk of expected inflation", 0.0, name="inflation_price_of_risk"
    )
    index_volatility: CaseInput = MOVING("volatility of realised inflation", 0.01)
    index_price_of_risk: CaseInput = PRICE_OF_RISK("price of the risk of realised inflation", 0.0)
    real_wage_growth: CaseInput = RATE("growth of wages beyond prices", 0.0, group="model")
    wage_volatility: CaseInput = QUIET_VOLATILITY("volatility of wages beyond prices", 0.0)


class AssetsTable(CaseTable):
    """`[assets]`: the classes, and the meaning of their mean returns."""

    file: Nonempty = csv(
        "classes of assets",
        "name,kind,mean,volatility,weight,low,high and, where they apply, others",
    )
    return_kind: Literal["excess", "total"] = doc(
        "whether means are over cash or of the whole return"
    )
    mean_kind: Literal["geometric", "arithmetic", "log"] = doc("kind of the mean returns")
    turnover: float | None = plain(
        "limit on trading, by default none",
        _above("the largest share of the assets traded per year,"),
        None,
    )


class CreditTable(CaseTable):
    """`[credit]`: credit spreads by rating."""

    file: Nonempty = csv(
        "credit spreads by rating",
        "rating,spread,mean_spread,mean_reversion,volatility,default_loss",
    )


class CurrenciesTable(CaseTable):
    """`[currencies]`: foreign currencies and their hedges."""

    file: Nonempty = csv("currencies", "currency,market,volatility,premium,hedge_ratio,hedge_cost")


class CorrelationsTable(CaseTable):
    """`[correlations]`: correlations of the shocks."""

    file: Nonempty = doc(
        "correlations of the shocks; others are independent",
        allowed="the name of a CSV file: a square matrix with names in the first row",
    )
    repair: bool = doc("whether an invalid matrix is replaced by the nearest valid one", False)


class OverlayTable(CaseTable):
    """`[overlay]`: receiver swaps by tenor, at par by default."""

    file: Nonempty = csv("swaps by tenor", "tenor,kind,notional,low,high,cost")
    unit: Literal["assets", "liability"] = doc("unit of the limits of notionals", "assets")
    leverage: CaseInput = SWAP_LIMIT(
        "largest sum of notionals, as a share of the assets", 1.0, range=NOT_NEGATIVE
    )
    collateral_stress: CaseInput = SWAP_LIMIT(
        "rise of all zero rates that collateral must withstand",
        0.035,
        unit=YEARLY,
        range=Range(0.0, noun="a rise in rates"),
    )


class ScenariosTable(CaseTable):
    """`[scenarios]`: ready-made scenarios instead of the models."""

    training: Nonempty = doc("scenarios for training", allowed="the name of a CSV file")
    evaluation: Nonempty = doc("scenarios for valuation", allowed="the name of another CSV file")


class PolicyTable(CaseTable):
    """`[policy]`: the observation, and the widths of the hidden layers."""

    observation: list[str] | None = doc("observations of the policy", None, "a list of names")
    hidden: HiddenLayers = doc("hidden layers", [32, 32], "a list of widths, such as [32, 32]")


class SensitivityTable(CaseTable):
    """`[sensitivity]`: the numbers that are held fixed."""

    held: list[str] = doc("inputs without a sensitivity", [], "a list of names of inputs")


class FrontierTable(CaseTable):
    """`[frontier]`: the efficient frontier of contributions against the shortfall."""

    points: int = plain("points of the frontier", Range(2, 20, noun=WHOLE), 5)
    steps: int = plain("training steps for every point", Range(1, noun=WHOLE), 60)
    level: float = plain(
        "level of the CVaR, the mean of the worst 1 - level of the paths", Range(0.5, 0.99), 0.95
    )


class StressTable(CaseTable):
    """`[stress]`: shocks for the table of the report."""

    file: Nonempty = csv("shocks of inputs, by scenario", "scenario,input,label,kind,size")


class FundReportTable(ReportTable):
    """`[report]`: the requested parts of a run, and texts of the report."""

    parts: PartNames = names_of_parts("sensitivities")


class RegulationTable(CaseTable):
    """`[regulation]`: a regulator's rules, and the figures that they need."""

    rules: Nonempty = doc(
        "rules of the regulator", allowed='"dutch-ftk", or the name of a TOML file of rules'
    )
    policy_ratios: list[Ratio] = doc(
        "past funding ratios, whose mean is the policy ratio; by default only today's",
        [],
        "funding ratios at the ends of the last months, the newest last",
    )
    insurance_risk: float = plain("capital for insurance risk", _share_of("the liability"), 0.0)
    active_risk: float = plain("capital for active risk", _share_of("the assets"), 0.0)


class PotsTable(CaseTable):
    """`[pots]`: personal pots by cohort, with a solidarity reserve."""

    rules: Nonempty = doc("law on pots", allowed='"dutch-wtp", or the name of a TOML file of rules')
    allocation: Nonempty = csv("protection and exposure by age", "age,protection,exposure")
    reserve: CaseInput = RESERVE(
        "solidarity reserve today", 0.0, range=_share_of("the assets"), name="reserve_today"
    )
    fill_contribution: CaseInput = RESERVE(
        "share of contributions that is paid into the solidarity reserve",
        0.0,
        range=_share_of("contributions"),
    )
    fill_return: CaseInput = RESERVE(
        "share of excess returns that is paid into the solidarity reserve",
        0.0,
        range=_share_of("a year's excess return"),
    )
    release: CaseInput = RESERVE(
        "largest share of the solidarity reserve that is released in a year",
        0.2,
        range=_share_of("the reserve"),
    )
    largest: CaseInput | None = RESERVE(
        "largest solidarity reserve", None, range=_share_of("the assets")
    )


class FundingTable(CaseTable):
    """`[funding]`: the bases of a scheme of the United Kingdom, side by side."""

    rules: Nonempty = doc(
        "rules of the scheme", allowed='"uk", or the name of a TOML file of rules'
    )
    technical_provisions: float = plain("discount rate of technical provisions", OVER_GILTS)
    low_dependency: float | None = plain("discount rate of low dependency", OVER_GILTS, None)
    buy_out: float = plain("discount rate of a buy-out", OVER_GILTS)
    recovery_years: float | None = plain("length of the recovery plan, in years", POSITIVE, None)


class PensionTable(CaseTable):
    """The whole file."""

    kind: Literal["pension"] = doc("kind of the case")
    title: Title = "Pension fund"
    fund: dict = subtable("horizon, steps and assets of the fund", "fund")
    curve: dict = subtable("nominal curve, and measure of the scenarios", "curve")
    rates: dict | None = subtable("model of the short rate", "rates", None)
    inflation: dict = subtable("break-evens, and models of inflation and wages", "inflation")
    assets: dict = subtable("classes of assets", "assets")
    credit: dict | None = subtable("spreads and defaults of credit by rating", "credit", None)
    currencies: dict | None = subtable("currencies of assets, and hedges", "currencies", None)
    correlations: dict | None = subtable("correlations of the shocks", "correlations", None)
    overlay: dict | None = subtable("receiver swaps by tenor", "overlay", None)
    members: dict = subtable("members, or their cash flows", "members")
    mortality: Annotated[dict | None, COHORTS] = subtable(
        "death probabilities and their improvement", "mortality", None
    )
    lee_carter: Annotated[dict | None, COHORTS, PROMISED] = subtable(
        "stochastic factor of mortality", "lee_carter", None
    )
    plan: dict = subtable("benefits of the plan", "plan", {})
    liability: dict = subtable("valuation of the liability", "liability", {})
    reconcile: dict | None = subtable(
        "figures of the actuary, with which the model is compared", "reconcile", None
    )
    scenarios: dict | None = subtable("ready-made scenarios", "scenarios", None)
    policy: dict = subtable("observation and network of the policy", "policy", {})
    objective: dict | list = doc(
        "statistics of the paths that are maximised",
        {},
        "the table [objective], or several [[objective]]",
    )
    sensitivity: dict = subtable("numbers without a sensitivity", "sensitivity", {})
    stress: dict | None = subtable("shocks for the table of stresses in the report", "stress", None)
    frontier: Annotated[dict | None, PROMISED] = subtable(
        "frontier of contributions against the shortfall, with a policy for every point",
        "frontier",
        None,
    )
    regulation: Annotated[dict | None, PROMISED] = subtable(
        "rules of a regulator, and the figures that they need", "regulation", None
    )
    funding: Annotated[dict | None, PROMISED] = subtable(
        "bases of a scheme of the United Kingdom", "funding", None
    )
    pots: dict | None = subtable("personal pots with a solidarity reserve", "pots", None)
    report: ReportKey
    training: TrainingKey
    evaluation: EvaluationKey
