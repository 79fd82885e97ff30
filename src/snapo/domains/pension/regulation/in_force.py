"""The state of the law on a date, from a file of rules with dates; also reads `[regulation]`."""

import datetime
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any, TypeVar

import numpy as np

from snapo.case.csv import FileReference, file_in_folder
from snapo.case.load import tables_of

from ..read.cells import TableReader
from ..read.tables import RegulationTable
from ..records.regulation import MARKETS, RISKS, Regulation, Rules

AnyRules = TypeVar("AnyRules")


def in_force(
    section: TableReader,
    name: str,
    local: Mapping[str, str],
    day: datetime.date,
    made: Callable[[dict[str, Any]], AnyRules],
) -> AnyRules:
    """The version of the rules `name` that is in force on `day`, converted by `made`; the rules are
    those of the package or a file.

    **Arguments:** - `local`: {name: file} of the rules that come with the package.

    **Raises:** `CaseError` if the file is missing or incomplete, or has no rules for the day.
    """
    try:
        if name in local:
            text = (files(__package__ or "") / local[name]).read_text(encoding="utf-8")
        else:
            if (section.file.parent / name).is_file():
                file_in_folder(FileReference(section, "rules", name), (".toml",))
            text = (section.file.parent / name).read_text(encoding="utf-8")
        versions = tables_of(section.file.parent / name, text)["version"]
        available = [(version["from"], version) for version in versions if version["from"] <= day]
    except FileNotFoundError:
        message = (
            "there is no such file, and the package has no rules of this name; it has "
            f"{', '.join(local)}"
        )
        raise section.error("rules", name, message) from None
    except (KeyError, TypeError, UnicodeDecodeError) as error:
        message = (
            f"it must be a TOML file with tables [[version]], each with a date `from` ({error})"
        )
        raise section.error("rules", name, message) from None
    if not available:
        raise section.error("rules", name, f"no version is in force on {day}")
    try:
        return made(max(available, key=lambda pair: pair[0])[1])
    except (KeyError, TypeError, ValueError) as error:
        message = f"its version for {day} has a missing or an invalid number: {error}"
        raise section.error("rules", name, message) from None


OWN = {"dutch-ftk": "dutch_ftk.toml"}  # rules that come with the package
FACTORS = ("rise", "fall", "real_rise", "real_fall")
RATINGS = ("AAA", "AA", "A", "BBB", "other")
CORRELATIONS = (
    "rates_equity", "rates_credit", "equity_credit", "equity", "currencies_developed",
    "currencies_emerging", "currencies",
)  # fmt: skip


def read_regulation(
    section: TableReader, table: RegulationTable | None, day: datetime.date
) -> Regulation | None:
    """The rules in force on `day`; None without the table.

    **Raises:** `CaseError` if the file is missing or incomplete, or has no rules for the day.
    """
    if table is None:
        return None
    rules = in_force(section, table.rules, OWN, day, _rules)
    if len(table.policy_ratios) > rules.averaging_months:
        message = (
            f"the policy ratio is the mean of {rules.averaging_months} months, so there must be "
            "no more ratios than months"
        )
        raise section.error("policy_ratios", len(table.policy_ratios), message)
    ratios = tuple(table.policy_ratios)
    return Regulation(rules, ratios, table.insurance_risk, table.active_risk)


def _rules(data: dict[str, Any]) -> Rules:
    rates = data["rates"]
    term = np.array(rates["term"], float)
    factors = {name: np.array(rates[name], float) for name in FACTORS}
    if any(factor.shape != term.shape for factor in factors.values()) or np.any(np.diff(term) <= 0):
        raise ValueError(
            "rates: there must be one factor for each term, and the terms must increase"
        )

    def numbers(name: str, keys: tuple[str, ...]) -> dict[str, float]:
        return {key: float(data[name][key]) for key in keys}

    return Rules(
        since=data["from"].isoformat(),
        source=str(data["source"]),
        averaging_months=int(data["averaging_months"]),
        recovery_years=float(data["recovery_years"]),
        minimum=float(data["minimum"]),
        term=term,
        factors=factors,
        falls=numbers("falls", RISKS[:-1]),
        currencies=numbers("currencies", MARKETS),
        spreads=numbers("spreads", RATINGS),
        correlations=numbers("correlations", CORRELATIONS),
    )
