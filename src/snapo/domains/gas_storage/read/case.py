"""Reads a gas-storage case: a TOML file and the CSVs beside it become a `StorageCase`."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.settings import (
    EvaluationTable,
    ObjectiveTable,
    TrainingTable,
    check_window,
    read_evaluation,
    read_objective,
    read_training,
)
from snapo.case.table import TableContext, parse

from ..contract.feasibility import check_feasible
from ..contract.records import StorageCase
from ..prices.process import Delivery
from ..prices.registry import check_curve, kinds, read_prices
from .contract import decision_days, pays_by_price, read_contract
from .limits import read_limits
from .market import read_market
from .plausible import end_too_early, free_money, unit_slips
from .tables import ContractTable, MarketTable, StorageTable

FORMATS = {
    "": StorageTable,
    "contract": ContractTable,
    "market": MarketTable,
    "model": [process.table for process in kinds().values()],
    "objective": ObjectiveTable,
    "training": TrainingTable,
    "evaluation": EvaluationTable,
}


def read_case(file: Path, data: Mapping[str, Any]) -> StorageCase:
    """The case in the TOML file `file`, whose tables were read already: `data`.

    Other files are looked for beside it. **Raises:** `CaseError` where a table, a file or a number
    is wrong, or where the contract cannot be met; nothing is written.
    """
    top = parse(StorageTable, data, str(file), "")
    notes: list[str] = []
    contract_table, market_table = _parse_both(top, str(file), notes)
    valuation, end = market_table.valuation_date, contract_table.end
    where = TableContext(file, "contract", notes)
    if end <= contract_table.start:
        message = f"the first day without a decision must come after start, {contract_table.start}"
        raise where.error("end", end, message)
    days = decision_days(contract_table, valuation)
    expired = valuation > end
    price_days = (*days, end) if pays_by_price(contract_table) and not expired else days
    unit = f"{contract_table.currency}/{contract_table.volume_unit}"
    limits = read_limits(where, contract_table, days)
    section = TableContext(file, "market", notes)
    market = read_market(section, market_table, days, price_days, limits.moving(), unit)
    contract = read_contract(where, contract_table, days, valuation, limits, market.gas_day)
    section = TableContext(file, "model", notes)
    delivery = Delivery(days, price_days, end, valuation, market.forward_curve)
    model = read_prices(section, top.model, delivery)
    check_curve(market_table.forward_curve, model, delivery)
    case = StorageCase(
        file=file,
        title=top.title,
        volume_unit=contract_table.volume_unit,
        currency=contract_table.currency,
        valuation_date=valuation,
        start=contract_table.start,
        end=end,
        days=days,
        day=np.array([(day - valuation).days for day in days], np.int64),
        end_day=(end - valuation).days,
        expired=expired,
        contract=contract,
        market=market,
        model=model,
        objective=read_objective(top.objective, str(file)),
        training=read_training(top.training, str(file)),
        evaluation=read_evaluation(top.evaluation, str(file)),
        notes=tuple(notes),
    )
    check_window(case.training, [case.objective.kind], str(file))
    if not expired:
        check_feasible(case)
    early = end_too_early(case.start, case.end)
    more = (*([early] if early else []), *unit_slips(case, data), *free_money(case))
    return dataclasses.replace(case, notes=(*case.notes, *more))


def _parse_both(
    top: StorageTable, file: str, notes: list[str]
) -> tuple[ContractTable, MarketTable]:
    """Both tables, with the mistakes of both in one message."""
    mistakes: list[CaseError] = []
    tables = []
    for table, data, name in (
        (ContractTable, top.contract, "contract"),
        (MarketTable, top.market, "market"),
    ):
        try:
            tables.append(parse(table, data, file, name, notes))
        except CaseError as error:
            mistakes.append(error)
    if mistakes:
        first, *rest = mistakes
        others = (*first.others, *rest)
        raise CaseError(first.file, first.where, first.value, first.allowed, others)
    return tables[0], tables[1]
