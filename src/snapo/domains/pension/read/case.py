"""Reads a pension case: a TOML file and the CSVs next to it become a `PensionCase`."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.load import load
from snapo.case.meaning import check_meanings
from snapo.case.parts import known_parts
from snapo.case.settings import (
    EvaluationTable,
    TrainingTable,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
    read_weight,
)
from snapo.case.table import AnyTable, CaseTable, nearest, parse

from ..fund.observation import FEATURES
from ..market.assets.asset_class import AssetNames
from ..market.correlation import all_names
from ..pots.read import check_pots, read_pots
from ..records.case import OUTPUTS, PARTS, ObjectiveTerm, PensionCase, missing_parts
from ..records.inputs import every_given
from ..records.plan import PensionPlan
from ..records.plausible import unit_slips
from ..records.pots import POT_OUTPUTS, pensions
from ..regulation.bases import read_funding
from ..regulation.in_force import read_regulation
from . import people, plan, tables, tables_people
from .assets import read_assets
from .cash_plan import PlanClock
from .cells import TableReader, TimeGrid, known_words
from .curve import read_correlations, read_curve, read_inflation, read_rates
from .holdings import read_credit, read_currencies, read_overlay
from .mortality import read_lee_carter, read_mortality
from .scenarios import read_scenarios
from .stress import parse_shocks, shock_sizes
from .tables import PensionTable

# All tables but those that are read with the files or rules that they name.
FORMATS: dict[str, type[CaseTable]] = {
    "fund": tables.FundTable,
    "curve": tables.CurveTable,
    "rates": tables.RatesTable,
    "inflation": tables.InflationTable,
    "assets": tables.AssetsTable,
    "credit": tables.CreditTable,
    "currencies": tables.CurrenciesTable,
    "correlations": tables.CorrelationsTable,
    "overlay": tables.OverlayTable,
    "members": tables_people.MembersTable,
    "mortality": tables_people.MortalityTable,
    "lee_carter": tables_people.LeeCarterTable,
    "plan": tables_people.PlanTable,
    "plan.indexation": tables_people.IndexationTable,
    "plan.revaluation": tables_people.RevaluationTable,
    "plan.contribution": tables_people.ContributionTable,
    "liability": tables_people.LiabilityTable,
    "reconcile": tables_people.ReconcileTable,
    "scenarios": tables.ScenariosTable,
    "policy": tables.PolicyTable,
    "sensitivity": tables.SensitivityTable,
    "report": tables.FundReportTable,
    "regulation": tables.RegulationTable,
    "funding": tables.FundingTable,
    "pots": tables.PotsTable,
    "frontier": tables.FrontierTable,
}
SCHEMA = {
    "": PensionTable, **FORMATS, "stress": tables.StressTable, "training": TrainingTable,
    "evaluation": EvaluationTable,
}  # fmt: skip
STEPS = {"month": 1 / 12, "year": 1.0}


def read_case(path: str | Path) -> PensionCase:
    """Reads and checks the case at `path`, a TOML file or a folder with `case.toml`.

    **Raises:** `CaseError` if a table, a file or a number is wrong; nothing is written.
    """
    file, data = load(Path(path))
    return resolve(file, data)


@dataclass(frozen=True)
class _Reader:
    """A case while it is read: its tables by name, without those that it does not have; `notes` are
    remarks for its user, `defaulted` the names of numbers that were left at a default."""

    file: Path
    top: PensionTable
    read: dict[str, CaseTable]
    notes: list[str]
    defaulted: set[str]

    def context(self, name: str) -> TableReader:
        return TableReader(self.file, name, self.notes, self.defaulted)

    def table(self, kind: type[AnyTable], name: str) -> AnyTable:
        """The table `name`, which the case has or which has a default for every key."""
        result = self.read[name]
        assert isinstance(result, kind)
        return result

    def optional_table(self, kind: type[AnyTable], name: str) -> AnyTable | None:
        """The table `name`, or None if the case has none."""
        return self.table(kind, name) if name in self.read else None


def parsed(file: Path, top: PensionTable) -> dict[str, CaseTable]:
    """The tables of a case by name; "" is the whole file.

    **Raises:** `CaseError` if a key is wrong, or has no meaning in this case.
    """
    if top.rates is None and top.scenarios is None:
        message = "this table is missing; only ready-made [scenarios] do not need it"
        raise CaseError(str(file), "rates", None, message)
    table: dict[str, CaseTable] = {"": top}
    for name, kind in FORMATS.items():
        above, _, key = name.rpartition(".")
        data = getattr(table[above], key)
        if data is not None:
            table[name] = parse(kind, data, str(file), name)
    check_meanings(str(file), table)
    return table


def resolve(file: Path, data: Mapping[str, Any]) -> PensionCase:
    """The case of TOML data that was read already; the other files are next to `file`."""
    top = parse(PensionTable, data, str(file), "")
    reader = _Reader(file, top, parsed(file, top), [], set())
    fund = reader.table(tables.FundTable, "fund")
    grid = TimeGrid(round(fund.years / STEPS[fund.step]), STEPS[fund.step], fund.currency)
    market = _market(reader, grid, fund.assets)
    classes = [class_.name for class_ in market["assets"].classes]
    annual = reader.table(tables.CurveTable, "curve").compounding == "annual"
    supplied, start = reader.optional_table(tables.ScenariosTable, "scenarios"), fund.valuation_date
    settings = reader.table(tables.PolicyTable, "policy")
    rules = _plan(reader, grid, start)
    lives = _people(reader, rules, grid, start)
    members, table = lives["members"], reader.optional_table(tables.PotsTable, "pots")
    pots = read_pots(reader.context("pots"), table, start, members, grid)
    more = () if pots is None else (*POT_OUTPUTS, *pensions(members))
    if pots is not None:  # rights are earned no more: contributions go into pots
        rules = replace(rules, accruing=False)
    if supplied is not None and market["overlay"] is not None and market["overlay"].inflation:
        message = "ready-made scenarios have no break-evens, which swaps of inflation need"
        raise CaseError(str(file), "overlay.file", None, message)
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
        **lives,
        plan=rules,
        liability=plan.read_liability(
            reader.context("liability"),
            reader.table(tables_people.LiabilityTable, "liability"),
            annual,
        ),
        reconcile=plan.read_reconcile(
            reader.optional_table(tables_people.ReconcileTable, "reconcile")
        ),
        scenarios=read_scenarios(
            reader.context("scenarios"), supplied, classes, grid, start.isoformat(), annual
        ),
        observation=(),
        hidden=tuple(settings.hidden),
        objective=read_objectives(str(file), top.objective, more),
        training=read_training(top.training, str(file)),
        evaluation=read_evaluation(top.evaluation, str(file)),
        regulation=read_regulation(
            reader.context("regulation"),
            reader.optional_table(tables.RegulationTable, "regulation"),
            start,
        ),
        funding=read_funding(
            reader.context("funding"), reader.optional_table(tables.FundingTable, "funding"), start
        ),
        pots=pots,
        frontier=plan.read_frontier(
            reader.context("frontier"),
            reader.optional_table(tables.FrontierTable, "frontier"),
            rules,
        ),
    )
    plan.check_limited(case)
    check_pots(str(file), pots, case.plan, case.liability)
    observed = settings.observation
    case = replace(
        case,
        observation=usual_observation(case) if observed is None else tuple(observed),
        held=_held(reader, case),
        notes=tuple(reader.notes),
        parts=known_parts(
            file,
            reader.table(tables.FundReportTable, "report").parts,
            PARTS,
            missing_parts(case, stress=top.stress is not None),
        ),
    )
    kinds = [term.objective.kind for term in case.objective]
    check_window(case.training, [*kinds, *(["cvar"] if case.frontier else [])], str(file))
    known_words(str(file), "policy.observation", case.observation, tuple(FEATURES))
    slips = unit_slips(case, data, shock_sizes(parse_shocks(case, top.stress)))
    return replace(case, notes=(*case.notes, *slips.values()), slips=tuple(slips))


def _market(reader: _Reader, grid: TimeGrid, amount: CaseInput) -> dict[str, Any]:
    """Curve, models and assets: fields of a `PensionCase`."""
    position, optional = reader.context, reader.optional_table
    curve = reader.table(tables.CurveTable, "curve")
    rates = read_rates(position("rates"), optional(tables.RatesTable, "rates"), grid)
    inflation = reader.table(tables.InflationTable, "inflation")
    credit = read_credit(position("credit"), optional(tables.CreditTable, "credit"))
    currencies = read_currencies(
        position("currencies"), optional(tables.CurrenciesTable, "currencies")
    )
    names = AssetNames(grid.step, credit.names, currencies.names)
    table = reader.table(tables.AssetsTable, "assets")
    assets = read_assets(position("assets"), table, amount, grid, names)
    motions = all_names(rates.factors, credit.names, currencies.names, assets)
    correlations = optional(tables.CorrelationsTable, "correlations")
    return {
        "measure": curve.measure,
        "curve": read_curve(position("curve"), curve),
        "rates": rates,
        "inflation": read_inflation(position("inflation"), inflation, grid, curve.compounding),
        "assets": assets,
        "credit": credit,
        "currencies": currencies,
        "correlation": read_correlations(
            position("correlations"), correlations, [name for name in motions if name]
        ),
        "overlay": read_overlay(
            position("overlay"), optional(tables.OverlayTable, "overlay"), grid
        ),
    }


def _plan(reader: _Reader, grid: TimeGrid, start: datetime.date) -> PensionPlan:
    """`[plan]` with the two tables below it."""
    table, money = reader.table(tables_people.PlanTable, "plan"), grid.currency
    timer = PlanClock(grid, start, table.timing == "arrears")
    names = ("plan.indexation", "plan.revaluation", "plan.contribution")
    indexation = reader.table(tables_people.IndexationTable, names[0])
    revaluation = reader.optional_table(tables_people.RevaluationTable, names[1])
    contribution = reader.table(tables_people.ContributionTable, names[2])
    return plan.read_plan(
        reader.context("plan"),
        table,
        plan.read_indexation(reader.context(names[0]), indexation),
        plan.read_revaluation(reader.context(names[1]), revaluation),
        plan.read_contribution(reader.context(names[2]), contribution, timer),
        money,
    )


def _people(
    reader: _Reader, rules: PensionPlan, grid: TimeGrid, start: datetime.date
) -> dict[str, Any]:
    """Members with their mortality, or the actuary's cash flows: fields of a `PensionCase`."""
    table, section = reader.table(tables_people.MembersTable, "members"), reader.context("members")
    names = ("members", "mortality", "lee_carter", "cash_flows")
    parts: dict[str, Any] = dict.fromkeys(names)
    if (table.file is None) == (table.cash_flows is None):
        got = None if table.file is None else table.cash_flows
        raise section.error("file", got, "either file or cash_flows is needed, but not both")
    if table.cash_flows is not None:
        arrears = rules.timing == "arrears"
        parts["cash_flows"] = people.read_cash_flows(section, table, arrears, grid)
        return parts
    if reader.top.mortality is None:
        raise CaseError(str(reader.file), "mortality", None, "cohorts need this table")
    mortality = read_mortality(
        reader.context("mortality"),
        reader.table(tables_people.MortalityTable, "mortality"),
        start,
    )
    values = (section, table, mortality, rules.retirement_age, grid)
    parts["members"], parts["mortality"] = people.read_members(*values), mortality
    lee_carter = reader.optional_table(tables_people.LeeCarterTable, "lee_carter")
    parts["lee_carter"] = read_lee_carter(reader.context("lee_carter"), lee_carter, mortality)
    return parts


def usual_observation(case: PensionCase) -> tuple[str, ...]:
    """The default observation: every part that has a meaning in this case."""
    return tuple(name for name, observed in FEATURES.items() if observed.usual(case))


def _held(reader: _Reader, case: PensionCase) -> tuple[str, ...]:
    """Names of inputs without a gradient: by request, left at a default, or without effect."""
    request = reader.table(tables.SensitivityTable, "sensitivity").held
    every = list(every_given(case))
    names, missing = (
        [item.name for item in every],
        "the rules and models of this case have no such number",
    )
    known_words(str(reader.file), "sensitivity.held", request, names, missing)
    idle = reader.defaulted | {entry.name for entry in _replaced(case)}
    if case.risk_neutral or case.scenarios is not None:
        idle |= {value.name for value in every if value.group == "premium"}
    return tuple(each.name for each in every if each.name in request or each.name in idle)


def _replaced(case: PensionCase) -> list[CaseInput]:
    """The numbers of all models whose place ready-made scenarios take."""
    if case.scenarios is None:
        return []
    models = (case.rates, case.inflation, case.credit, case.currencies, case.correlation)
    numbers = [values for model in models for values in every_given(model)]
    return [*numbers, case.assets.volatility, case.assets.smoothing]


# The output of each kind of objective, if the case does not name one.
USUAL = {"cvar": "surplus_ratio", "mean": "funding_ratio"}


def read_objectives(file: str, data: Any, more: Sequence[str] = ()) -> tuple[ObjectiveTerm, ...]:
    """The terms of the objective, from one table or several. `more`: outputs that the case has in
    addition to those of every fund."""
    many = isinstance(data, list)
    terms = data if many else [data or {"kind": "crra", "risk_aversion": 5.0}]
    if not terms:
        raise CaseError(file, "objective", data, "at least one table is needed")
    return tuple(
        _term(file, f"objective.{i}" if many else "objective", term, (*OUTPUTS, *more))
        for i, term in enumerate(terms, 1)
    )


def _term(file: str, name: str, data: Any, available: Sequence[str]) -> ObjectiveTerm:
    if not isinstance(data, Mapping):
        raise CaseError(file, name, data, "this must be a table")
    rest = {key: value for key, value in data.items() if key not in ("weight", "output")}
    table = read_objective(rest, file, name, optional=("wealth",))
    weight = read_weight(data, table, file, name)
    output = data.get("output", USUAL.get(table.kind, "funding_ratio"))
    if output not in available:
        close = nearest(str(output), available)
        raise CaseError(file, f"{name}.output", output, f"there is no such output; {close}")
    return ObjectiveTerm(weight, str(output), table)
