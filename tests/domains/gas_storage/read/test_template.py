"""The case that `snapo new gas-storage` writes: every key is there, with its default or an example."""

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from snapo.case.load import load
from snapo.case.settings import EvaluationTable, FittedTable, ObjectiveTable
from snapo.domains.gas_storage import DOMAIN
from snapo.domains.gas_storage.hedges.table import HedgeTable
from snapo.domains.gas_storage.history.table import BacktestTable
from snapo.domains.gas_storage.ladder.products import ProductsTable
from snapo.domains.gas_storage.prices.registry import kinds
from snapo.domains.gas_storage.read.tables import ContractTable, MarketTable
from snapo.domains.gas_storage.setup import bare_problem, fitted_value, make_setup
from snapo.solver.learning.settings import FITTED
from snapo.study import commands

from ..storage_cases import read

G1 = Path(__file__).parents[1] / "cases" / "G1"
# Keys whose comment shows an example, since they have no default or a plain one.
EXAMPLES = {"min_inventory", "max_injection", "max_withdrawal", "fixed_costs", "outages"}
EXAMPLES |= {"end_inventory", "end_value", "level", "risk_aversion", "wealth", "target"}
EXAMPLES |= {"patience", "window", "clip", "keep", "validation_every", "quotes", "curve"}
EXAMPLES |= {*ProductsTable.model_fields, "deltas", "least_variance", "nomination"}


def test_commented_keys_of_the_new_case_are_right():
    """Every commented-out key exists, and has the default that the comment shows; none is left out."""
    models = [kind.table.model_fields for kind in kinds().values()]
    tables = {
        "contract": ContractTable.model_fields,
        "market": MarketTable.model_fields,
        "model": {key: field for fields in models for key, field in fields.items()},
        "objective": ObjectiveTable.model_fields,
        "products": ProductsTable.model_fields,
        "hedge": HedgeTable.model_fields,
        "backtest": BacktestTable.model_fields,
        "training": FittedTable.model_fields,
        "evaluation": EvaluationTable.model_fields,
    }
    text = (DOMAIN.templates["flagship"] / "case.toml").read_text(encoding="utf-8")
    table, mentioned = "", {name: set() for name in tables}
    for line in text.splitlines():
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
            if line.startswith("#") and table != "model" and key not in EXAMPLES:
                assert value == (FITTED.get(key) or field.default), key
    for name, fields in tables.items():
        assert set(fields) == mentioned[name], name


def test_every_kind_of_price_stands_in_the_template():
    text = (DOMAIN.templates["flagship"] / "case.toml").read_text(encoding="utf-8")
    for kind in kinds():
        assert f'kind = "{kind}"' in text


def test_the_domain_is_light_until_there_is_work():
    code = "import sys; from snapo.domains.gas_storage import DOMAIN; DOMAIN.templates; "
    code += "print([name for name in ('jax', 'numpy', 'pydantic') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr


def test_new_writes_the_flagship_case(tmp_path):
    folder = tmp_path / "a" / "store"
    commands.new("gas-storage", folder)
    assert {p.name for p in folder.iterdir()} == {
        "case.toml",
        "curve.csv",
        "rates.csv",
        "ratchets.csv",
    }
    written, reference = DOMAIN.read(*load(folder)), DOMAIN.read(*load(G1))
    assert written.days == reference.days
    for record in ("market", "contract", "model"):
        assert numbers(getattr(written, record)) == numbers(getattr(reference, record))
    assert written.training == reference.training
    assert written.evaluation == reference.evaluation


def test_a_fitted_mean_has_few_small_steps():
    """Of a tail, whose rule is fitted to another objective, and where steps are specified, the
    usual rate."""

    def trained(**tables: dict[str, Any]) -> tuple[int, float]:
        case = read("G1", **tables)
        plan = make_setup(case, fit=fitted_value(bare_problem(case))).training
        return plan.steps, plan.learning_rate

    assert trained() == (20, 0.001)
    assert trained(training={"steps": 30}) == (30, 0.01)
    assert trained(objective={"kind": "cvar", "level": 0.9}) == (240, 0.01)


def numbers(record) -> dict:
    """The numbers of a record, to compare."""
    found = {}
    for name, entry in vars(record).items():
        if hasattr(entry, "used"):
            found[name] = entry.used().tolist()
        elif isinstance(entry, np.ndarray):
            found[name] = entry.tolist()
    return found
