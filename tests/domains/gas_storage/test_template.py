"""The example that `snapo new gas-storage` writes: the flagship case, and right in its comments."""

import tomllib
from pathlib import Path

import numpy as np

from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.case.table import load
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.prices.registry import kinds
from snapo.domains.gas_storage.read.tables import ContractTable, MarketTable
from snapo.study import commands

CASES = Path(__file__).parent / "cases"


def test_new_writes_the_flagship_case(tmp_path):

    folder = tmp_path / "a" / "store"
    commands.new("gas-storage", folder)
    assert {p.name for p in folder.iterdir()} == {
        "case.toml",
        "curve.csv",
        "rates.csv",
        "ratchets.csv",
    }
    written, reference = DOMAIN.read(*load(folder)), DOMAIN.read(*load(CASES / "G1"))
    assert written.days == reference.days
    for record in ("market", "contract", "model"):
        assert numbers(getattr(written, record)) == numbers(getattr(reference, record))
    assert (written.training, written.evaluation) == (reference.training, reference.evaluation)


def numbers(record) -> dict:
    """The numbers of a record, to compare."""
    found = {}
    for name, entry in vars(record).items():
        if hasattr(entry, "used"):
            found[name] = entry.used().tolist()
        elif isinstance(entry, np.ndarray):
            found[name] = entry.tolist()
    return found


def test_commented_keys_of_the_new_case_are_right(tmp_path):
    """Every commented-out key exists, and has the default that the comment shows."""

    commands.new("gas-storage", tmp_path)
    tables = {
        "contract": ContractTable.model_fields,
        "market": MarketTable.model_fields,
        "model": {
            key: field
            for kind in kinds().values()
            for key, field in kind.table.model_fields.items()
        },
        "objective": ObjectiveTable.model_fields,
        "training": TrainingTable.model_fields,
        "evaluation": EvaluationTable.model_fields,
    }
    examples = {"min_inventory", "max_injection", "max_withdrawal", "fixed_costs", "outages"}
    examples |= {"end_inventory", "end_value", "level", "risk_aversion", "wealth", "target"}
    examples |= {"patience", "window", "clip"}
    table, mentioned = "", {name: set() for name in tables}
    for line in (tmp_path / "case.toml").read_text(encoding="utf-8").splitlines():
        bare = line.removeprefix("# ").split("  #")[0].strip()
        if bare.strip("[]") in tables and bare.startswith("["):
            table = bare.strip("[]")
        try:
            entry = tomllib.loads(bare)
        except tomllib.TOMLDecodeError:
            continue
        for key, value in entry.items():
            if table == "" or bare.startswith("["):
                continue
            field = tables[table][key]
            mentioned[table].add(key)
            if line.startswith("#") and table != "model" and key not in examples:
                assert value == field.default, key
    for name, fields in tables.items():
        assert set(fields) == mentioned[name], name
