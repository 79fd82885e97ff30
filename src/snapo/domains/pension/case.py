"""Reads a pension case: a TOML file and the CSVs beside it become a `PensionCase`."""

import datetime
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from snapo.case.error import CaseError
from snapo.case.settings import read_evaluation, read_objective, read_training
from snapo.case.table import Section, Table, load, nearest, parse

from . import case_assets, case_curve, case_people, case_plan, tables
from .case_assets import Grid
from .case_correlation import correlated, read_correlations
from .case_scenarios import read_scenarios
from .cells import known_words
from .inputs import every_given
from .observation import NAMES
from .records import ObjectiveTerm, PensionCase
from .records_people import Plan
from .simulator import OUTPUTS
from .stress import parse_shocks
from .tables import PensionTable

AnyTable = TypeVar("AnyTable", bound=Table)
STEPS = {"month": 1 / 12, "year": 1.0}
# What each kind of objective is asked of, where the case does not name an output.
USUAL = {"cvar": "surplus_ratio", "mean": "funding_ratio"}
# What counts in the real world only, and what ready-made scenarios take the place of.
REAL_WORLD = (
    "rate_price_of_risk",
    "inflation_price_of_risk",
    "index_price_of_risk",
    "asset_mean",
    "credit_default_loss",
    "currency_premium",
)
GENERATED = (
    *REAL_WORLD,
    *("break_even", "ultimate_break_even"),
    *("rate_mean_reversion", "rate_volatility", "inflation_mean_reversion"),
    *("inflation_volatility", "index_volatility", "real_wage_growth", "wage_volatility"),
    *("asset_volatility", "asset_smoothing", "correlation"),
    *(f"credit_{name}" for name in ("spread", "mean_spread", "mean_reversion", "volatility")),
    *("currency_volatility", "currency_hedge_ratio", "currency_hedge_cost"),
)
# Inputs whose number stands in a table of the case: where it was left at its default, it is held.
WRITTEN = {
    "rate_price_of_risk": ("rates", "price_of_risk"),
    "inflation_mean_reversion": ("inflation", "mean_reversion"),
    "inflation_volatility": ("inflation", "volatility"),
    "inflation_price_of_risk": ("inflation", "price_of_risk"),
    "index_volatility": ("inflation", "index_volatility"),
    "index_price_of_risk": ("inflation", "index_price_of_risk"),
    "real_wage_growth": ("inflation", "real_wage_growth"),
    "wage_volatility": ("inflation", "wage_volatility"),
    "overlay_leverage": ("overlay", "leverage"),
    "overlay_collateral_stress": ("overlay", "collateral_stress"),
    "mortality_multiplier": ("mortality", "multiplier"),
    "improvement": ("mortality", "improvement"),
    "normal_cost": ("members", "normal_cost"),
    "payroll": ("members", "salary"),
}


def read_case(path: str | Path) -> PensionCase:
    """Reads and checks the case at `path`, a TOML file or a folder with `case.toml`.

    **Raises:** `CaseError` where a table, a file or a number is wrong; nothing is written.
    """
    file, data = load(Path(path))
    return resolve(file, data)


class _Reader:
    """One case while it is read: its tables by name, and the remarks collected on the way."""

    def __init__(self, file: Path, top: PensionTable):
        self.file, self.top, self.notes = file, top, []

    def section(self, name: str) -> Section:
        return Section(self.file, name, self.notes)

    def table(self, kind: type[AnyTable], name: str, data: Any = None) -> AnyTable:
        """The table `name`, which the case has or which has a default for every key."""
        found = getattr(self.top, name) if data is None else data
        return parse(kind, found, str(self.file), name)

    def maybe(self, kind: type[AnyTable], name: str) -> AnyTable | None:
        """The table `name`, or None where the case has none."""
        return None if getattr(self.top, name) is None else self.table(kind, name)


def resolve(file: Path, data: dict[str, Any]) -> PensionCase:
    """The same for TOML data that was read already; other files are looked for beside `file`."""
    top = parse(PensionTable, data, str(file), "")
    reader = _Reader(file, top)
    fund = reader.table(tables.FundTable, "fund")
    grid = Grid(round(fund.years / STEPS[fund.step]), STEPS[fund.step], fund.currency)
    market = _market(reader, grid, fund.assets)
    classes = [each.name for each in market["assets"].classes]
    supplied, start = reader.maybe(tables.ScenariosTable, "scenarios"), fund.valuation_date
    settings = reader.table(tables.PolicyTable, "policy")
    plan = _plan(reader, fund.currency)
    case = PensionCase(
        file=file,
        title=top.title,
        currency=fund.currency,
        valuation_date=start.isoformat(),
        step=grid.step,
        steps=grid.steps,
        # Time 0 is the beginning of a month that is nearest to the date: 31 December is January.
        start_month=(start + datetime.timedelta(15)).month,
        **market,
        **_people(reader, plan, grid),
        plan=plan,
        liability=case_plan.read_liability(
            reader.section("liability"), reader.table(tables.LiabilityTable, "liability")
        ),
        reconcile=case_plan.read_reconcile(reader.maybe(tables.ReconcileTable, "reconcile")),
        scenarios=read_scenarios(
            reader.section("scenarios"), supplied, classes, grid, start.isoformat()
        ),
        observation=(),
        hidden=tuple(settings.hidden),
        objective=_objective(str(file), top.objective),
        training=read_training(top.training, str(file)),
        evaluation=read_evaluation(top.evaluation, str(file)),
        frontier=case_plan.read_frontier(
            reader.section("frontier"), reader.maybe(tables.FrontierTable, "frontier"), plan
        ),
    )
    seen = settings.observation
    case = replace(
        case,
        observation=usual_observation(case) if seen is None else tuple(seen),
        held=_held(reader, case),
        notes=tuple(reader.notes),
    )
    known_words(str(file), "policy.observation", case.observation, NAMES)
    parse_shocks(case, top.stress)
    return case


def _market(reader: _Reader, grid: Grid, amount: float) -> dict[str, Any]:
    """Curve, models and assets: fields of a `PensionCase`."""
    top, section = reader.top, reader.section
    curve = reader.table(tables.CurveTable, "curve")
    rates_table = reader.maybe(tables.RatesTable, "rates")
    if rates_table is None and top.scenarios is None:
        what = "this table is missing; only ready-made [scenarios] go without it"
        raise CaseError(str(reader.file), "rates", None, what)
    rates = case_curve.no_rates(grid.steps)
    if rates_table is not None:
        rates = case_curve.read_rates(section("rates"), rates_table, grid.steps, grid.step)
    inflation = reader.table(tables.InflationTable, "inflation")
    credit = case_assets.read_credit(section("credit"), reader.maybe(tables.CreditTable, "credit"))
    currencies = case_assets.read_currencies(
        section("currencies"), reader.maybe(tables.CurrenciesTable, "currencies")
    )
    table = reader.table(tables.AssetsTable, "assets")
    given = (section("assets"), table, amount, grid, credit.names, currencies.names)
    assets = case_assets.read_assets(*given)
    known = correlated(rates, assets, credit, currencies)
    return {
        "measure": curve.measure,
        "curve": case_curve.read_curve(section("curve"), curve),
        "rates": rates,
        "inflation": case_curve.read_inflation(
            section("inflation"), inflation, grid.steps, grid.step
        ),
        "assets": assets,
        "credit": credit,
        "currencies": currencies,
        "correlation": read_correlations(
            section("correlations"), reader.maybe(tables.CorrelationsTable, "correlations"), known
        ),
        "overlay": case_assets.read_overlay(
            section("overlay"), reader.maybe(tables.OverlayTable, "overlay"), grid
        ),
    }


def _plan(reader: _Reader, money: str) -> Plan:
    """`[plan]` with the two tables below it."""
    table = reader.table(tables.PlanTable, "plan")
    names = ("plan.indexation", "plan.contribution")
    indexation = reader.table(tables.IndexationTable, names[0], table.indexation)
    contribution = reader.table(tables.ContributionTable, names[1], table.contribution)
    return case_plan.read_plan(
        reader.section("plan"),
        table,
        case_plan.read_indexation(reader.section(names[0]), indexation),
        case_plan.read_contribution(reader.section(names[1]), contribution, money),
        money,
    )


def _people(reader: _Reader, plan: Plan, grid: Grid) -> dict[str, Any]:
    """Members with their mortality, or the actuary's cash flows: fields of a `PensionCase`."""
    table, section = reader.table(tables.MembersTable, "members"), reader.section("members")
    names = ("members", "mortality", "lee_carter", "cash_flows")
    found: dict[str, Any] = dict.fromkeys(names)
    if (table.file is None) == (table.cash_flows is None):
        got = None if table.file is None else table.cash_flows
        raise section.error("file", got, "either file or cash_flows is needed, and not both")
    if table.cash_flows is not None:
        for name in ("mortality", "lee_carter"):
            if getattr(reader.top, name) is not None:
                what = "cash flows of the actuary's own leave nothing to this table"
                raise CaseError(str(reader.file), name, None, what)
        arrears = plan.timing == "arrears"
        found["cash_flows"] = case_people.read_cash_flows(section, table, arrears, grid)
        return found
    for key in ("normal_cost", "salary"):
        if key in table.model_fields_set:
            raise section.error(key, getattr(table, key), "this key goes with cash_flows")
    if reader.top.mortality is None:
        raise CaseError(str(reader.file), "mortality", None, "cohorts need this table")
    mortality = case_people.read_mortality(
        reader.section("mortality"), reader.table(tables.MortalityTable, "mortality")
    )
    given = (section, table, mortality, plan.retirement_age, grid)
    found["members"], found["mortality"] = case_people.read_members(*given), mortality
    lee_carter = reader.maybe(tables.LeeCarterTable, "lee_carter")
    found["lee_carter"] = case_people.read_lee_carter(
        reader.section("lee_carter"), lee_carter, mortality
    )
    return found


def usual_observation(case: PensionCase) -> tuple[str, ...]:
    """What a policy sees unless told otherwise: every name that means something in this case."""
    absent = {
        "rates": case.scenarios is not None,
        "inflation": case.scenarios is not None,
        "spreads": not case.credit.names or case.scenarios is not None,
        "mortality": case.lee_carter is None,
        "overlay": case.overlay is None,
        # The funding ratio itself is there already.
        "relative_funding": True,
        "short_rate": case.scenarios is None,
        "long_rate": case.scenarios is None,
        "accrued": True,
    }
    return tuple(name for name in NAMES if not absent.get(name, False))


def _objective(file: str, data: Any) -> tuple[ObjectiveTerm, ...]:
    """One table, or several that are added up."""
    many = isinstance(data, list)
    terms = data if many else [data or {"kind": "crra", "risk_aversion": 5.0}]
    if not terms:
        raise CaseError(file, "objective", data, "at least one table is needed")
    found = []
    for i, each in enumerate(terms, 1):
        name = f"objective.{i}" if many else "objective"
        if not isinstance(each, Mapping):
            raise CaseError(file, name, each, "this must be a table")
        rest = {key: value for key, value in each.items() if key not in ("weight", "output")}
        table = read_objective(rest, file, name, optional=("wealth",))
        weight = each.get("weight", 1.0)
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not weight:
            raise CaseError(file, f"{name}.weight", weight, "allowed is a number other than 0")
        output = each.get("output", USUAL.get(table.kind, "funding_ratio"))
        if output not in OUTPUTS:
            close = nearest(str(output), OUTPUTS)
            raise CaseError(file, f"{name}.output", output, f"there is no such output; {close}")
        found.append(ObjectiveTerm(float(weight), str(output), table))
    return tuple(found)


def _held(reader: _Reader, case: PensionCase) -> tuple[str, ...]:
    """Names of inputs without a gradient: asked for, left at a default, or without effect."""
    asked = reader.table(tables.SensitivityTable, "sensitivity").held
    present = [given.name for given in every_given(case)]
    known_words(str(reader.file), "sensitivity.held", asked, present)
    idle = set(GENERATED) if case.scenarios is not None else set()
    idle |= set(REAL_WORLD) if case.risk_neutral else set()
    for name, (table, key) in WRITTEN.items():
        if key not in (getattr(reader.top, table) or {}):
            idle.add(name)
    return tuple(name for name in present if name in asked or name in idle)
