"""Cases in a few words, for tests."""

from pathlib import Path
from typing import Any

from snapo.domains.inventory.item.records import InventoryCase
from snapo.domains.inventory.read.case import read_case
from snapo.lanes.machine import disk, pipeline

MEAN = 5.0


HERE = Path(__file__).parent


def case(demand: dict[str, Any] | None = None, folder: Path = HERE, **item: Any) -> InventoryCase:
    """A case with these keys of `[item]`; those of other tables by their names, as tables.

    - `folder`: where its other files are.
    """
    tables = ("horizon", "training", "evaluation", "season")
    other = {name: item.pop(name) for name in tables if name in item}
    usual = {"unmet": "lost", "lead_time": 2, "holding": 1.0, "shortage": 4.0}
    tables = {
        "kind": "inventory",
        "item": usual | item,
        "demand": demand or {"kind": "poisson", "mean": MEAN},
        **other,
    }
    return read_case(folder / "case.toml", tables)


def optimised(monkeypatch) -> None:
    """From now on LLVM's passes are run, as for users: on many paths they save more than they
    take."""
    for module in (disk, pipeline):
        monkeypatch.setattr(module, "PIPELINE", pipeline.Pipeline())
