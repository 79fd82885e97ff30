"""Collects the price processes of this folder, and reads `[model]` with the process of its
`kind`."""

import pkgutil
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.table import TableContext, parse, record_kinds

from .factors import FactorPrices
from .process import KINDS, Delivery, PriceProcess

for _file in pkgutil.iter_modules([str(Path(__file__).parent)]):
    if _file.name != Path(__file__).stem:
        import_module(f"{__package__}.{_file.name}")


def kinds() -> dict[str, type[PriceProcess]]:
    """All price processes, by their name in `[model]`."""
    return dict(KINDS)


def read_prices(section: TableContext, data: Mapping[str, Any], delivery: Delivery) -> PriceProcess:
    """The price process of the table `[model]`, here `data`."""
    kind = data.get("kind")
    record_kinds(data, section.name, "kind", KINDS)
    if not isinstance(kind, str) or kind not in KINDS:
        available = ", ".join(f'"{item}"' for item in sorted(KINDS))
        raise section.error("kind", kind, f"it must be one of {available}")
    process = KINDS[kind]
    if delivery.nominated is not None and not issubclass(process, FactorPrices):
        suited = [item for item, of in KINDS.items() if issubclass(of, FactorPrices)]
        allowed = ", ".join(f'"{item}"' for item in sorted(suited))
        raise section.error("kind", kind, f"with [contract] nomination it must be one of {allowed}")
    table = parse(process.table, data, str(section.file), section.name, section.notes)
    return process.read(section, table, delivery)


def check_curve(file: str, process: PriceProcess, delivery: Delivery) -> None:
    """Raises `CaseError` if a price that is proportional to the forward curve has a curve that is
    not above 0."""
    curve = delivery.curve
    if not process.proportional:
        return
    for t in np.flatnonzero(curve.values <= 0)[:1]:
        message = f'model kind "{process.kind}" multiplies the forward price, which must be above 0'
        raise CaseError(file, curve.labels[t], float(curve.values[t]), message)
