"""Reads `[model]`: price factors of the spot, or supplied price paths."""

import datetime
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from snapo.case.csv import Mention, read_array
from snapo.case.dates import dated, single
from snapo.case.error import CaseError, Unquoted
from snapo.case.given import Given
from snapo.case.table import Section, parse

from .records import FactorModel, Model, SeasonalModel, SuppliedModel
from .tables import (
    MODELS,
    FactorTable,
    MultiFactorTable,
    OneFactorTable,
    SeasonalTable,
    SuppliedTable,
)

VOLATILITY = "1/sqrt(year)"


def read_model(
    section: Section,
    data: Mapping[str, Any],
    days: Sequence[datetime.date],
    price_days: Sequence[datetime.date],
    end: datetime.date,
    valuation: datetime.date,
) -> Model:
    """The price model of decision days `days` [T] and the end date, from the table `data`."""
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in MODELS:
        kinds = ", ".join(f'"{known}"' for known in MODELS)
        raise section.error("kind", kind, f"allowed is one of {kinds}")
    table = parse(MODELS[kind], data, str(section.file), section.name)
    dates = (*days, end)
    if isinstance(table, OneFactorTable):
        return _factors(section, "one-factor", [table], [], dates)
    if isinstance(table, MultiFactorTable):
        factors = _read_factors(section, table.factors)
        correlation = _read_correlation(section, table.correlation, len(factors))
        return _factors(section, "multi-factor", factors, correlation, dates)
    if isinstance(table, SeasonalTable):
        return SeasonalModel(
            single("spot_mean_reversion", table.spot_mean_reversion, "1/year"),
            single("spot_volatility", table.spot_volatility, VOLATILITY),
            single("long_term_volatility", table.long_term_volatility, VOLATILITY),
            single("seasonal_volatility", table.seasonal_volatility, VOLATILITY),
            season(dates, valuation),
        )
    return _supplied(section, table, price_days)


def season(dates: Sequence[datetime.date], valuation: datetime.date) -> np.ndarray:
    """cos(2 pi d / 365.25), d = days from 1 February of the valuation year to each date."""
    peak = datetime.date(valuation.year, 2, 1)
    days = np.array([(date - peak).days for date in dates], np.float64)
    return np.cos(2 * math.pi * days / 365.25)


def _factors(section, kind, factors, correlation, dates) -> FactorModel:
    """Puts the factors' numbers end to end; `index` says which of them day t and factor i use."""
    numbered = kind == "multi-factor"
    values, labels, columns = [], [], []
    for number, factor in enumerate(factors, 1):
        key = f"factors.{number}.volatility" if numbered else "volatility"
        given = dated(section, key, factor.volatility, VOLATILITY, dates, low=0.0)
        columns.append(given.index + len(values))
        values.extend(given.values)
        labels.extend(f"{number} {label}".strip() if numbered else label for label in given.labels)
    index = np.stack(columns, axis=1)
    volatility = Given("volatility", np.array(values), tuple(labels), VOLATILITY, index)
    names = tuple(str(number) if numbered else "" for number in range(1, len(factors) + 1))
    reversions = np.array([factor.mean_reversion for factor in factors])
    count = np.arange(len(factors))
    reversion = Given("mean_reversion", reversions, names, "1/year", count)
    pairs = tuple(f"{i},{j}" for i in range(2, len(factors) + 1) for j in range(1, i))
    lower = np.array(correlation, np.float64)
    return FactorModel(
        kind, reversion, volatility, Given("correlation", lower, pairs, "1", np.arange(len(pairs)))
    )


def _read_factors(section: Section, given: list[Any]) -> list[FactorTable]:
    file = str(section.file)
    return [
        parse(FactorTable, entry, file, f"{section.name}.factors.{number}")
        for number, entry in enumerate(given, 1)
    ]


def _read_correlation(section: Section, given, size: int) -> list[float]:
    """The strict lower triangle of a matrix that is checked to be a correlation matrix."""
    if given is None and size == 1:
        return []
    if given is None:
        what = f"{size} factors need a correlation matrix of {size} rows and {size} columns"
        raise section.error("correlation", None, what)
    if len(given) != size or any(len(row) != size for row in given):
        what = f"{size} factors need {size} rows and {size} columns"
        raise section.error("correlation", given, what)
    matrix = np.array(given, np.float64)
    for i in range(size):
        if matrix[i, i] != 1:
            raise section.error(f"correlation.{i + 1},{i + 1}", matrix[i, i], "allowed is 1")
        for j in range(i):
            if matrix[i, j] != matrix[j, i]:
                what = f"the matrix must be symmetric, and {j + 1},{i + 1} is {matrix[j, i]:g}"
                raise section.error(f"correlation.{i + 1},{j + 1}", matrix[i, j], what)
            if not -1 <= matrix[i, j] <= 1:
                what = "allowed is a number from -1 to 1"
                raise section.error(f"correlation.{i + 1},{j + 1}", matrix[i, j], what)
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 1e-12:
        what = (
            "a correlation matrix must be positive definite, and the least eigenvalue of this "
            f"one is {smallest:.3g}; factors that move as one are one factor"
        )
        raise section.error("correlation", given, what)
    return list(matrix[np.tril_indices(size, -1)])


def _supplied(section: Section, table: SuppliedTable, price_days) -> SuppliedModel:
    if not price_days:
        # No decision is left: whatever the paths say is over.
        return SuppliedModel(np.zeros((2, 0)), np.zeros((2, 0)), table.rescale_to_curve)
    span = f"one for each day from {price_days[0]} to {price_days[-1]}"
    mentions = [
        Mention(section, key, getattr(table, key)) for key in ("training_paths", "evaluation_paths")
    ]
    arrays = [read_array(mention, len(price_days), span) for mention in mentions]
    if np.array_equal(arrays[0], arrays[1]):
        what = "this holds the same paths as training_paths; evaluation needs paths of its own"
        raise mentions[1].error(what)
    if table.rescale_to_curve:
        arrays = [
            _noise(mention.name, array, price_days)
            for mention, array in zip(mentions, arrays, strict=True)
        ]
    return SuppliedModel(arrays[0], arrays[1], table.rescale_to_curve)


def _noise(name: str, array: np.ndarray, days) -> np.ndarray:
    """The paths over their mean of the day, so that the expected spot is the forward price."""
    mean = array.mean(axis=0)
    for column in np.flatnonzero(mean <= 0)[:1]:
        got = Unquoted(f"a mean price of {mean[column]:g}")
        what = "rescale_to_curve needs a mean above 0 on every day"
        raise CaseError(name, f"day {days[column]}", got, what)
    return array / mean
