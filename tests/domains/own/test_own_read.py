"""Cases with a simulator of one's own: what is read, and the message for every mistake."""

import numpy as np
import pytest
from tests.domains.own.small import CASE, PLACE, SIMULATOR, write

import snapo
from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.cli.main import main
from snapo.domains.own import DOMAIN
from snapo.study.domain import Domain, RunsCode


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty place to work in, which is not the folder of the case."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    return tmp_path / "case"


def read(folder, name: str = "Shop"):
    file, data = load(folder)
    return DOMAIN.with_simulator("simulator", name).read(file, data)


def test_the_domain_fits_its_protocols():
    assert isinstance(DOMAIN, Domain)
    assert isinstance(DOMAIN, RunsCode)


def test_a_case_is_read(folder):
    case = read(write(folder))
    assert (case.title, case.step, case.unit) == ("Shop", "day", "EUR")
    assert case.outputs == {"objective": "profit"}
    assert case.objective == snapo.Mean("profit")
    demand, price = case.inputs["demand"], case.inputs["price"]
    assert demand.value.tolist() == [10, 11, 12, 13, 14, 15, 16, 17]
    assert demand.labels[:2] == ("d0", "d1")
    assert (price.move, price.display_unit, price.display_factor) == (0.1, "cents", 100)
    assert case.inputs["stock"].meaning == "at the start"
    assert case.simulator.horizon == 8
    assert case.code == folder / "simulator.py"


def test_the_code_decides_the_numbers(folder):
    case = read(write(folder))
    decides = DOMAIN.decides(case)
    assert decides["simulator"] == "simulator:Shop"
    write(folder, SIMULATOR + "\n# changed\n")
    assert DOMAIN.decides(read(folder)) != decides


def test_the_simulator_beside_the_case_comes_before_one_of_the_same_name_here(folder, tmp_path):
    write(folder)
    (tmp_path / "here" / "simulator.py").write_text("raise RuntimeError('the wrong one')")
    assert read(folder).code == folder / "simulator.py"
    (folder / "simulator.py").rename(tmp_path / "here" / "simulator.py")
    assert read(folder).code == tmp_path / "here" / "simulator.py"


def test_from_case_makes_the_simulator(folder):
    made = (
        SIMULATOR.replace("horizon, noise_size = 8, 1", "horizon: int\n    noise_size = 1")
        + """
    @classmethod
    def from_case(cls, tables, folder):
        return cls(horizon=tables["simulator"]["days"])
"""
    )
    case = read(write(folder, made, CASE + "[simulator]\ndays = 8\n"))
    assert case.simulator.horizon == 8


def test_inputs_of_any_shape(folder):
    text = CASE.replace("value = 3,", "value = [[1, 2], [3, 4]],")
    assert np.array_equal(read(write(folder, case=text)).inputs["price"].value, [[1, 2], [3, 4]])


def test_the_objective_has_its_own_keys(folder):
    text = CASE.replace('"profit"\n[inputs]', '"profit"\nkind = "cvar"\nlevel = 0.9\n[inputs]')
    case = read(write(folder, case=text))
    assert case.objective == snapo.CVaR("profit", 0.9)
    assert case.objective_words == "mean of the worst 10 % of profit"


def test_several_objectives_are_added_up(folder):
    terms = """[[objective]]
output = "profit"
[[objective]]
output = "profit"
kind = "cvar"
level = 0.9
weight = 0.5
[[objective]]
output = "sold"
weight = -2
"""
    case = read(write(folder, case=CASE.replace('[objective]\noutput = "profit"\n', terms)))
    worst = 0.5 * snapo.CVaR("profit", 0.9)
    found, wanted = case.objective, snapo.Mean("profit") + worst - 2 * snapo.Mean("sold")
    totals = {"profit": np.arange(40.0) ** 2, "sold": np.arange(40.0)}
    assert found.value(totals) == pytest.approx(wanted.value(totals))
    words = "mean of profit + 0.5 × mean of the worst 10 % of profit - 2 × mean of sold"
    assert case.objective_words == words
    assert case.unit == ""  # euros and pieces


def test_a_negative_weight_of_a_measure_of_risk_is_that_of_a_cost(folder):
    """The dearest tenth of 0 … 99 is 94.5 on average, the cheapest one 4.5."""
    text = CASE.replace(
        '[objective]\noutput = "profit"',
        '[[objective]]\noutput = "profit"\nkind = "cvar"\nlevel = 0.9\nweight = -1',
    )
    case = read(write(folder, case=text))
    assert case.objective.value({"profit": np.arange(100.0)}) == pytest.approx(-94.5)


MISTAKES = {
    "no code": ([], "", "", "cannot name code", "simulator:Reservoir"),
    "no module": (["--simulator", "nothing:Shop"], "", "", "got nothing:Shop", "no nothing.py in"),
    "no class": (["--simulator", "simulator:Stop"], "", "", "has no Stop; its classes are Shop"),
    "no simulator": (["--simulator", "simulator:jnp"], "", "", "is not a subclass of snapo.Sim"),
    "python's own": (["--simulator", "json:Shop"], "", "", "Python has a module of this name"),
    "no output": (PLACE, 'output = "profit"', "", "objective.output: this key is missing"),
    "weight": (PLACE, '[objective]\n', "[[objective]]\nweight = 0\n", "objective.1.weight: got 0"),
    "utility of a cost": (
        PLACE, '[objective]\n', '[[objective]]\nkind = "crra"\nrisk_aversion = 2\nwealth = 1\nweight = -1\n',
        "objective.1.weight: got -1; a utility must be of a quantity that is maximised",
    ),
    "no table": (PLACE, "cost = { value = 1,", "cost = 1 #", "inputs.cost: got 1; an input must be a"),
    "no number": (PLACE, "value = 1,", 'value = "1",', "inputs.cost.value: got '1'; it must be a"),
    "no value": (PLACE, "value = 1,", "", "inputs.cost.value: this key is missing; write value ="),
    "both": (PLACE, "value = 1,", 'value = 1, file = "demand.csv",', "either a value or a file"),
    "column": (PLACE, 'column = "mean"', 'column = "median"', "column median is missing"),
    "file": (PLACE, '"demand.csv"', '"demands.csv"', "there is no such file", "(there are demand.csv)"),
    "outside": (PLACE, '"demand.csv"', '"../demand.csv"', "must be in the folder of the case"),
    "key": (PLACE, "words = ", "word = ", "inputs.stock.word", "the nearest known key is words"),
    "table": (PLACE, "[training]", "[trainings]", "trainings", "the nearest known key is training"),
    "move": (PLACE, "move = 1 ", "move = 0 ", "inputs.stock.move: got 0; it must be a number other"),
    "own table": (PLACE, "[units]", "[simulator]\ndays = 3\n[units]", "no class method from_case"),
    "steps": (PLACE, "steps = 30", "steps = -30", "training.steps: got -30"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_the_case_has_its_key(name, folder, capsys):
    options, before, after, *clauses = MISTAKES[name]
    assert not before or before in CASE
    write(folder, case=CASE.replace(before, after, 1) if before else CASE)
    assert main(["check", str(folder), *options]) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    for clause in clauses:
        assert clause in message


@pytest.mark.parametrize(
    ("before", "after", "clauses"),
    [
        ("import snapo", "import snapo as", ["simulator.py, line 3", "invalid syntax"]),
        (
            "import snapo",
            "import snappo",
            ["line 3", "No module named 'snappo'. In: import snappo"],
        ),
        ("snapo.Box(0.0", "snapo.Box(30.0", ["line 10", "low must be below high"]),
        ("horizon, noise_size = 8, 1", "noise_size = 1", ["TypeError"]),
    ],
)
def test_code_that_cannot_be_run_is_named_with_its_line(before, after, clauses, folder, capsys):
    write(folder, SIMULATOR.replace(before, after, 1))
    assert main(["check", str(folder), *PLACE]) == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    assert "simulator.py" in message
    for clause in clauses:
        assert clause in message, message


def test_a_case_that_names_code_itself_is_refused(folder, capsys):
    write(folder, case='simulator = "simulator:Shop"\n' + CASE)
    assert main(["check", str(folder)]) == 2
    assert main(["check", str(folder), *PLACE]) == 2
    assert "simulator: got 'simulator:Shop'" in capsys.readouterr().err


def test_size_and_bench_are_refused_with_a_reason(folder, capsys):
    assert main(["new", "own", str(folder), "--size", "large"]) == 2
    assert "this kind has one example only" in capsys.readouterr().err
    assert main(["bench", "own"]) == 2
    assert "there are no separate times for this kind" in capsys.readouterr().err


def test_an_unreadable_module_message_names_what_raised():
    with pytest.raises(CaseError, match="there is no"):
        from pathlib import Path

        from snapo.domains.own.load import load_class

        load_class("no_module_here", "X", Path("/tmp"))
