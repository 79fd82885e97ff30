"""Each mistake in a storage case: exit code 2, a message that names it, and nothing written."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from snapo.cli.main import main

CASES = Path(__file__).parents[1] / "cases"

# Each mistake: the file to spoil, what is replaced by what (None: the whole file, as bytes or
# text; `...`: the file is removed), and what the message must name.
MISTAKES = {
    "missing file": (
        "curve.csv", None, ...,
        ["market.forward_curve", "'curve.csv'", "no such file"],
    ),
    "bad date in the curve": (
        "curve.csv", "2021-06,", "2021-13,",
        ["curve.csv, line 4", "'2021-13'"],
    ),
    "no such day": ("rates.csv", "2021-06-01", "2021-06-31", ["rates.csv, line 3", "'2021-06-31'"]),
    "bad date in the case": (
        "case.toml", "end = 2022-04-01", "end = 2022-04-31",
        ["case.toml", "line 8", "contract.end: got 2022-04-31"],
    ),
    "date with a time": (
        "case.toml", "end = 2022-04-01", "end = 2022-04-01T06:00:00",
        ["contract.end", "2022-04-01T06"],
    ),
    "date beyond reason": (
        "case.toml", "end = 2022-04-01", "end = 9999-12-31",
        ["contract.end", "9999"],
    ),
    "quoted date": (
        "case.toml", "end = 2022-04-01", 'end = "2022-04-01"',
        ["contract.end", "'2022-04-01'", "without quotation marks"],
    ),
    "hole in the curve": (
        "curve.csv", "2021-10,15.96\n", "",
        ["curve.csv", "2021-10-01", "no price"],
    ),
    "curve that ends early": ("curve.csv", "2022-03,16.81\n", "", ["curve.csv", "2022-03-01"]),
    "negative rate limit": (
        "ratchets.csv", ",2000,200,175", ",2000,200,-175",
        ["ratchets.csv, line 3", "max_injection", "'-175'", "at least 0"],
    ),
    "negative plain rate": (
        "case.toml", 'ratchets = "ratchets.csv"', "max_injection = -25.0\nmax_withdrawal = 30.0",
        ["contract.max_injection", "-25", "at least 0"],
    ),
    "NaN in the case": (
        "case.toml", "spot_volatility = 0.85", "spot_volatility = nan",
        ["model.spot_volatility", "nan", "a number of at least 0, and finite"],
    ),
    "infinite number in the case": (
        "case.toml", "injection_cost = 0.01", "injection_cost = inf",
        ["contract.injection_cost", "inf"],
    ),
    "NaN in a CSV": (
        "curve.csv", "15.68", "nan",
        ["curve.csv, line 3", "price", "'nan'", "finite"],
    ),
    "infinite number in a CSV": ("curve.csv", "15.68", "1e999", ["curve.csv, line 3", "'1e999'"]),
    "empty cell": ("curve.csv", "15.68", "", ["curve.csv, line 3", "empty cell"]),
    "decimal comma": ("curve.csv", "15.68", "15,68", ["curve.csv, line 3", "3 cells", "point"]),
    "ratchets out of order": (
        "ratchets.csv", ",2000,200,175\n,5000,260,155", ",5000,260,155\n,2000,200,175",
        ["ratchets.csv, line 4", "inventory", "'2000'", "5000"],
    ),
    "ratchet blocks out of order": (
        "ratchets.csv", ",2000,200,175", "2020-04-01,0,200,175",
        ["ratchets.csv, line 3", "'2020-04-01'", "2021-04-01"],
    ),
    "ratchets without a date": (
        "ratchets.csv", "2021-04-01,", ",",
        ["ratchets.csv, line 2", "date"],
    ),
    "ratchets begin too late": (
        "ratchets.csv", "2021-04-01,", "2021-06-01,", ["ratchets.csv", "2021-06-01", "2021-04-25"]
    ),
    "ratchets end too low": (
        "ratchets.csv", ",7000,275,132\n", "", ["ratchets.csv", "5000", "max_inventory, 7000"]
    ),
    "both kinds of rates": (
        "case.toml", "injection_cost = 0.01", "max_injection = 5.0",
        ["contract.max_injection", "not both"],
    ),
    "half of the rates": (
        "case.toml", 'ratchets = "ratchets.csv"', "max_injection = 5.0",
        ["contract.max_withdrawal", "missing"],
    ),
    "inventory above its limit": (
        "case.toml", "inventory = 1500.0", "inventory = 8000.0",
        ["contract.inventory", "8000", "2021-04-25", "0 to 7000"],
    ),
    "limits crossed": (
        "case.toml", "max_inventory = 7000.0", "max_inventory = 7000.0\nmin_inventory = 7001.0",
        ["contract.min_inventory", "7001", "2021-04-25", "7000"],
    ),
    "end level out of reach": (
        "case.toml", "valuation_date = 2021-04-25", "valuation_date = 2022-03-25",
        ["contract.end_inventory", "got 0", "2022-04-01"],
    ),
    "end level outside its limits": (
        "case.toml", "end_inventory = 0.0", "end_inventory = 7500.0",
        ["contract.end_inventory", "7500", "0 to 7000"],
    ),
    "minimum inventory out of reach": (
        "case.toml", "max_inventory = 7000.0", 'max_inventory = 7000.0\nmin_inventory = "min.csv"',
        ["contract.min_inventory", "5000", "2021-05-10"],
    ),
    "forced flow against an outage": (
        "case.toml", "end_inventory = 0.0",
        'end_inventory = 0.0\nmin_injection = 5.0\noutages = ["2021-07-01/2021-07-14"]',
        ["contract.min_injection", "5", "2021-07-01", "outage"],
    ),
    "forced flow above the rate": (
        "case.toml", "end_inventory = 0.0", "end_inventory = 0.0\nmin_withdrawal = 300.0",
        ["contract.min_withdrawal", "300", "2021-04-25", "187.5"],
    ),
    "forced flow into a full store": (
        "case.toml", "end_inventory = 0.0", 'end_inventory = "free"\nmin_injection = 100.0',
        ["contract.max_inventory", "7000", "2021-06-20"],
    ),
    "both flows forced": (
        "case.toml", "end_inventory = 0.0", "min_injection = 5.0\nmin_withdrawal = 6.0",
        ["contract.min_injection", "2021-04-25", "both forced"],
    ),
    "unknown key": (
        "case.toml", "max_inventory = 7000.0", "max_inventory = 7000.0\nmax_injecton = 5.0",
        ["contract.max_injecton", "got 5", "no such key", "max_injection"],
    ),
    "unknown table": (
        "case.toml", "[model]", "[trainin]\nsteps = 5\n[model]",
        ["trainin", "no such key", "training"],
    ),
    "unknown key in training": (
        "case.toml", "[model]", "[training]\nstep = 5\n[model]",
        ["training.step", "got 5", "no such key", "steps"],
    ),
    "key of another model": (
        "case.toml", "spot_volatility = 0.85", "spot_volatility = 0.85\nmean_reversion = 12.0",
        ["model.mean_reversion", "12", "spot_mean_reversion"],
    ),
    "missing key": ("case.toml", "inventory = 1500.0\n", "", ["contract.inventory", "missing"]),
    "missing table": ("case.toml", "[market]", "[evaluation]", ["market", "missing"]),
    "missing model parameter": (
        "case.toml", "spot_volatility = 0.85\n", "", ["model.spot_volatility", "missing"]
    ),
    "wrong type": (
        "case.toml", "inventory = 1500.0", 'inventory = "much"',
        ["contract.inventory", "'much'", "number"],
    ),
    "truth value for a number": (
        "case.toml", "injection_cost = 0.01", "injection_cost = true",
        ["contract.injection_cost", "true"],
    ),
    "table for a number": (
        "case.toml", "inventory = 1500.0", "inventory = { a = 1 }",
        ["contract.inventory", "{ a = 1 }"],
    ),
    "number for a file": (
        "case.toml", 'forward_curve = "curve.csv"', "forward_curve = 16.0",
        ["market.forward_curve", "16", "CSV"],
    ),
    "another kind": (
        "case.toml", 'kind = "gas-storage"', 'kind = "gas-storag"',
        ["kind", "'gas-storag'", '"gas-storage"'],
    ),
    "no kind": ("case.toml", 'kind = "gas-storage"\n', "", ["kind", "missing", '"gas-storage"']),
    "unknown model": (
        "case.toml", '"three-factor-seasonal"', '"three-factor"', ["model.kind", "'three-factor'"]
    ),
    "unknown word": (
        "case.toml", '"linear"', '"cubic"', ["contract.ratchet_interpolation", "'cubic'", '"step"']
    ),
    "settlement without sense": (
        "case.toml", "{ months = 1, day = 20 }", '"monthly"',
        ["market.settlement", "'monthly'", '"flow"'],
    ),
    "settlement with a missing part": (
        "case.toml", "{ months = 1, day = 20 }", "{ months = 1 }",
        ["market.settlement", "{ months = 1 }"],
    ),
    "end before start": (
        "case.toml", "end = 2022-04-01", "end = 2021-04-01",
        ["contract.end", "2021-04-01", "after start"],
    ),
    "bad outage": (
        "case.toml", "end_inventory = 0.0", 'outages = ["2021-07-14/2021-07-01"]',
        ["contract.outages", "2021-07-14/2021-07-01"],
    ),
    "value at a fixed end level": (
        "case.toml", "end_inventory = 0.0", "end_inventory = 0.0\nend_value = 0.5",
        ["contract.end_value", "0.5", '"free"'],
    ),
    "empty curve": ("curve.csv", None, "", ["curve.csv", "empty", "date,price"]),
    "curve with a header only": ("curve.csv", None, "date,price\n", ["curve.csv", "no rows"]),
    "empty case": ("case.toml", None, "", ["case.toml", "empty"]),
    "no TOML": ("case.toml", "[market]", "[market", ["case.toml, line 17", "TOML", "[market"]),
    "missing column": ("curve.csv", "date,price", "date,prize", ["curve.csv, line 1", "price"]),
    "semicolons": (
        "curve.csv", None, "date;price\n2021-04;16,61\n2021-05;16.61\n",
        ["curve.csv, line 2, column price", "a decimal comma and 16.61 a point"],
    ),
    "Latin-1": (
        "curve.csv", None, "date,price\n2021-04,16 £\n".encode("latin-1"),
        ["curve.csv", "UTF-8"],
    ),
    "UTF-16": (
        "curve.csv", None, "date,price\n2021-04,16\n".encode("utf-16"),
        ["curve.csv", "UTF-8"],
    ),
    "UTF-16 without a mark": (
        "curve.csv", None, "date,price\n2021-04,16\n".encode("utf-16-le"), ["curve.csv", "UTF-8"]
    ),
    "case in Latin-1": (
        "case.toml", None, "title = 'Gas für £'".encode("latin-1"),
        ["case.toml", "UTF-8"],
    ),
    "month twice": ("curve.csv", "2021-05,", "2021-04,", ["curve.csv, line 3", "'2021-04'"]),
    "rates that do not rise": (
        "rates.csv", "2021-08-01", "2021-05-01", ["rates.csv, line 4", "'2021-05-01'", "2021-06-01"]
    ),
    "rate in percent": (
        "rates.csv", "0.005", "5.0",
        ["rates.csv, line 2", "'5.0'", "between -1 and 1"],
    ),
    "price that is not positive": (
        "curve.csv", "2021-06,15.42", "2021-06,-15.42",
        ["curve.csv", "2021-06-01", "-15.42", "above 0"],
    ),
    "temperature that rises": (
        "case.toml", "[model]", "[training]\ntemperature_end = 0.5\n[model]",
        ["training.temperature_end", "0.5", "0.02"],
    ),
    "objective without its level": (
        "case.toml", "[model]", '[objective]\nkind = "cvar"\n[model]', ["objective.level", '"cvar"']
    ),
    "objective with a key of another": (
        "case.toml", "[model]", "[objective]\nlevel = 0.9\n[model]",
        ["objective.level", "0.9", '"mean"', '"cvar"'],
    ),
    "file elsewhere": (
        "case.toml", '"curve.csv"', '"../curve.csv"',
        ["market.forward_curve", "'../curve.csv'", "in the folder"],
    ),
    "absolute file": (
        "case.toml", '"curve.csv"', '"/etc/curve.csv"', ["market.forward_curve", "in the folder"]
    ),
}  # fmt: skip

CORRELATED = """[model]
kind = "multi-factor"
factors = [{{ mean_reversion = 9, volatility = 0.6 }}, {{ mean_reversion = 0, volatility = 0.3 }}]
correlation = {}
"""

# Mistakes in [model], which is replaced as a whole.
BAD_MODELS = {
    "not positive definite": (
        CORRELATED.format("[[1.0, 1.0], [1.0, 1.0]]"), ["model.correlation", "positive definite"]
    ),
    "above one": (CORRELATED.format("[[1.0, 1.3], [1.3, 1.0]]"), ["model.correlation.2,1", "1.3"]),
    "not symmetric": (
        CORRELATED.format("[[1.0, 0.3], [0.2, 1.0]]"), ["model.correlation.2,1", "0.2", "0.3"]
    ),
    "no matrix": (CORRELATED.format("[[1.0, 0.3]]"), ["model.correlation", "2 rows"]),
    "diagonal": (CORRELATED.format("[[1.0, 0.3], [0.3, 2.0]]"), ["model.correlation.2,2", "got 2"]),
    "no correlation": (
        CORRELATED.format("[[1.0]]").replace("correlation", "# "),
        ["model.correlation", "2 factors"],
    ),
    "negative mean reversion": (
        'kind = "one-factor"\nmean_reversion = -1.0\nvolatility = 0.6',
        ["model.mean_reversion", "-1"],
    ),
    "negative volatility in a factor": (
        CORRELATED.format("[[1, 0], [0, 1]]").replace("0.6", "-0.6"),
        ["model.factors.1.volatility", "-0.6"],
    ),
    "unknown key in a factor": (
        CORRELATED.format("[[1, 0], [0, 1]]").replace("volatility", "volatilty", 1),
        ["model.factors.1.volatilty", "no such key", "volatility"],
    ),
    "one file for both": (
        'kind = "supplied"\ntraining_paths = "c.npy"\nevaluation_paths = "c.npy"',
        ["model.evaluation_paths", "'c.npy'", "same paths"],
    ),
    "pickled paths": (
        'kind = "supplied"\ntraining_paths = "pickled.npy"\nevaluation_paths = "a.npy"',
        ["pickled.npy"],
    ),
    "too few days": (
        'kind = "supplied"\ntraining_paths = "a.npy"\nevaluation_paths = "b.npy"',
        ["a.npy", "(4, 3)", "341 columns", "2021-04-25"],
    ),
    "other files": (
        'kind = "supplied"\ntraining_paths = "a.pkl"\nevaluation_paths = "b.npy"',
        ["model.training_paths", "'a.pkl'", ".npy"],
    ),
}  # fmt: skip


@pytest.fixture
def case(tmp_path):
    """A copy of the flagship case that a test may spoil."""
    path = Path(shutil.copytree(CASES / "G1", tmp_path / "G1"))
    (path / "min.csv").write_text("date,value\n2021-04-25,0\n2021-05-10,5000\n2021-05-11,0\n")
    return path


def listing(folder: Path) -> dict[str, bytes]:
    """Every file below `folder` with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def refused(folder: Path, capsys, named: list[str]) -> str:
    """Asserts exit code 2, the message on stderr, and that `solve` wrote nothing; returns it."""
    before = listing(folder.parent)
    assert main(["solve", str(folder), "--out", str(folder.parent / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("snapo: ")
    assert len(printed.err.splitlines()) == 1
    for name in named:
        assert name in printed.err, printed.err
    assert listing(folder.parent) == before
    assert not (folder.parent / "out").exists()
    assert main(["check", str(folder)]) == 2
    return printed.err


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_and_nothing_is_written(mistake, case, capsys):
    name, old, new, named = MISTAKES[mistake]
    file = case / name
    if new is ...:
        file.unlink()
    elif old is None:
        file.write_bytes(new if isinstance(new, bytes) else new.encode())
    else:
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new, 1), encoding="utf-8")
    refused(case, capsys, named)


@pytest.mark.parametrize("mistake", BAD_MODELS)
def test_a_mistake_in_the_model_is_named(mistake, case, capsys):
    model, named = BAD_MODELS[mistake]
    np.save(case / "a.npy", np.ones((4, 3)))
    np.save(case / "c.npy", np.ones((4, 341)))
    np.save(case / "b.npy", np.full((4, 3), 2.0))
    np.save(case / "pickled.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    text = (case / "case.toml").read_text(encoding="utf-8")
    head = text[: text.index("[model]")]
    model = model if model.startswith("[model]") else "[model]\n" + model
    (case / "case.toml").write_text(head + model, encoding="utf-8")
    refused(case, capsys, named)


def test_several_mistakes_are_told_at_once(case, capsys):
    text = (case / "case.toml").read_text(encoding="utf-8")
    text = text.replace("start = ", "strat = ").replace("settlement = ", "settlment = ")
    (case / "case.toml").write_text(text, encoding="utf-8")
    assert main(["check", str(case)]) == 2
    message = capsys.readouterr().err
    for name in ("contract.strat", "nearest known key is start", "market.settlment"):
        assert name in message
    assert len(message.splitlines()) == 2


def test_a_case_that_is_not_there(tmp_path, capsys):
    assert main(["check", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err
