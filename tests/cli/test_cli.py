"""The `snapo` command: quick answers, thin dispatch, new cases, a simulator of one's own."""

import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
import types
from pathlib import Path

import numpy as np
import pytest
from snapo.cli.own import read_own

from snapo.cli.main import main

CASES = Path(__file__).parents[1] / "domains" / "gas_storage" / "cases"
RUN = "snapo.domains.gas_storage.run"


@pytest.fixture
def case(tmp_path):
    """A copy of the flagship case that a test may spoil."""
    return Path(shutil.copytree(CASES / "G1", tmp_path / "G1"))


def test_json_prints_one_object_even_for_bad_input(case, capsys):
    (case / "curve.csv").unlink()
    assert main(["solve", str(case), "--json"]) == 2
    printed = capsys.readouterr()
    answer = json.loads(printed.out)
    assert answer["status"] == "bad-input"
    assert "curve.csv" in answer["message"]
    assert "curve.csv" in printed.err


# What the commands call.


@pytest.fixture
def domain(monkeypatch):
    """A domain's `run` module that records how it is called."""
    calls = []

    def solve(case, **options):
        calls.append((case, options))
        print("a library prints")
        numbers = {
            "value": np.float64(12.5),
            "standard_error": float("nan"),
            "seed": options["seed"],
        }
        return {"kind": "gas-storage", "status": "ok", "run": options["out"], **numbers}

    fake = types.ModuleType(RUN)
    fake.solve = solve
    fake.check = lambda case: ["fine"]
    fake.report = lambda folder: folder / "report.html"
    monkeypatch.setitem(sys.modules, RUN, fake)
    return calls


def test_solve_passes_on_what_was_asked(domain, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--out", str(out), "--seed", "7", "--engine", "xla", "--reference", "--resume"]
    assert main(["solve", str(CASES / "quick"), *options]) == 0
    case, given = domain[0]
    assert case.title == "Thirty days"
    assert callable(given.pop("progress"))
    assert given == {"out": out, "seed": 7, "engine": "xla", "reference": True, "resume": True}
    assert "12.50" in capsys.readouterr().out


def test_solve_has_defaults(domain):
    assert main(["solve", str(CASES / "quick" / "case.toml")]) == 0
    given = domain[0][1]
    assert given["out"] == CASES / "quick" / "run"
    assert (given["seed"], given["engine"], given["resume"]) == (0, "auto", False)


def test_json_is_exactly_one_object(domain, tmp_path, capsys):
    assert main(["solve", str(CASES / "quick"), "--json", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert result["value"] == 12.5
    assert result["standard_error"] is None
    assert result["run"] == str(tmp_path)
    assert "a library prints" in printed.err


def test_check_prints_findings(domain, capsys):
    assert main(["check", str(CASES / "quick")]) == 0
    assert capsys.readouterr().out == "fine\n"


def test_report_needs_a_run(domain, tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert "result.json" in capsys.readouterr().err
    (tmp_path / "result.json").write_text('{"kind": "gas-storage"}')
    assert main(["report", str(tmp_path)]) == 0
    assert "report.html" in capsys.readouterr().out


# A new case.


def test_new_writes_the_flagship_case(tmp_path, capsys):
    from snapo.domains.gas_storage.case import read_case

    folder = tmp_path / "a" / "store"
    assert main(["new", "gas-storage", str(folder)]) == 0
    assert {p.name for p in folder.iterdir()} == {
        "case.toml",
        "curve.csv",
        "rates.csv",
        "ratchets.csv",
    }
    written, reference = read_case(folder), read_case(CASES / "G1")
    assert written.days == reference.days
    for record in ("market", "contract", "model"):
        assert numbers(getattr(written, record)) == numbers(getattr(reference, record))
    assert (written.training, written.evaluation) == (reference.training, reference.evaluation)
    assert str(folder / "case.toml") in capsys.readouterr().out


def numbers(record) -> dict:
    """The numbers of a record, to compare."""
    found = {}
    for name, entry in vars(record).items():
        if hasattr(entry, "used"):
            found[name] = entry.used().tolist()
        elif isinstance(entry, np.ndarray):
            found[name] = entry.tolist()
    return found


def listing(folder: Path) -> dict[str, bytes]:
    """Every file below `folder` with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_new_overwrites_nothing(tmp_path, capsys):
    (tmp_path / "rates.csv").write_text("mine")
    assert main(["new", "gas-storage", str(tmp_path)]) == 2
    assert "rates.csv" in capsys.readouterr().err
    assert listing(tmp_path) == {"rates.csv": b"mine"}


def test_commented_keys_of_the_new_case_are_right(tmp_path):
    """Every commented-out key exists, and has the default that the comment shows."""
    from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
    from snapo.domains.gas_storage.tables import MODELS, ContractTable, MarketTable

    main(["new", "gas-storage", str(tmp_path)])
    tables = {
        "contract": ContractTable.model_fields,
        "market": MarketTable.model_fields,
        "model": {
            key: field for kind in MODELS.values() for key, field in kind.model_fields.items()
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


# The command line itself.


def run_python(*arguments: str) -> subprocess.CompletedProcess:
    source = str(Path(__file__).parents[2] / "src")
    environment = os.environ | {"PYTHONPATH": source}
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=environment, timeout=60
    )


LIGHT = """
import sys
from snapo.cli.main import main
try:
    code = main({!r})
except SystemExit as stop:
    code = stop.code
print(code, sorted(name for name in ("jax", "numpy", "pydantic") if name in sys.modules))
"""


@pytest.mark.parametrize(
    ("arguments", "code"),
    [(["--help"], 0), (["solve", "--help"], 0), (["sovle"], 2), (["new", "gas", "x"], 2),
     (["solve", "x", "--seed", "-1"], 2), (["solve", "x", "--simulator", "os"], 2), ([], 2)],
)  # fmt: skip
def test_help_and_wrong_arguments_import_nothing_heavy(arguments, code):
    done = run_python("-c", LIGHT.format(arguments))
    assert done.stdout.splitlines()[-1] == f"{code} []"
    assert "usage: snapo" in done.stdout + done.stderr


def test_help_answers_at_once():
    def seconds() -> float:
        began = time.perf_counter()
        assert run_python("-m", "snapo.cli.main", "--help").returncode == 0
        return time.perf_counter() - began

    # The best of five, since other work on the machine only ever adds.
    assert min(seconds() for _ in range(5)) < 0.3


def test_bad_input_is_found_without_jax(case):
    (case / "curve.csv").write_text("")
    done = run_python("-c", LIGHT.format(["solve", str(case)]))
    assert done.stdout.splitlines()[-1] == "2 ['numpy', 'pydantic']"
    assert "curve.csv: the file is empty" in done.stderr


# A simulator of one's own.

OWN = """
class Mine:
    @classmethod
    def from_case(cls, case, folder):
        return case["title"], folder, "objective"

class Poor:
    pass
"""


@pytest.mark.parametrize(
    ("simulator", "named"),
    [
        ("no_such_module:Mine", ["no_such_module:Mine", "no module"]),
        ("own_module_for_tests:Yours", ["own_module_for_tests", "no Yours"]),
        ("own_module_for_tests:Poor", ["from_case"]),
    ],
)
def test_a_simulator_that_cannot_be_used(simulator, named, tmp_path, monkeypatch, capsys):
    (tmp_path / "own_module_for_tests.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    assert main(["solve", str(CASES / "quick"), "--simulator", simulator]) == 2
    message = capsys.readouterr().err
    for name in named:
        assert name in message


def test_a_simulator_of_ones_own_reads_its_case(tmp_path, monkeypatch):
    (tmp_path / "own_module_for_tests.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    file, own = read_own(("own_module_for_tests", "Mine"), CASES / "quick")
    assert file == CASES / "quick" / "case.toml"
    assert (own["simulator"], own["inputs"]) == ("Thirty days", CASES / "quick")
    assert (own["training"].steps, own["evaluation"].paths) == (60, 4096)
