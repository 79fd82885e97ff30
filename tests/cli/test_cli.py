"""The `snapo` command: quick answers, one JSON object, new cases, mistakes before any work."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.miniatures import MINIATURES

from snapo.cli import commands as printed
from snapo.cli.main import main
from snapo.study import commands

CASES = Path(__file__).parents[1] / "domains" / "gas_storage" / "cases"
OWN = MINIATURES["own"]
SIMULATOR = ["--simulator", ":".join(OWN.simulator)]


@pytest.fixture
def case(tmp_path):
    """A copy of the flagship case that a test may spoil."""
    return Path(shutil.copytree(CASES / "G1", tmp_path / "G1"))


@pytest.fixture
def own(tmp_path):
    """The example of a simulator of one's own."""
    assert main(["new", "own", str(tmp_path / "own")]) == 0
    return tmp_path / "own"


def listing(folder: Path) -> dict[str, bytes]:
    """Every file below `folder` with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# A new case.


def test_new_lists_the_kinds(capsys):
    assert main(["new"]) == 0
    printed = capsys.readouterr().out
    for kind in MINIATURES:
        assert kind in printed


def test_new_writes_the_example(tmp_path, capsys):
    own = tmp_path / "own"
    assert main(["new", "own", str(own)]) == 0
    assert {"case.toml", "simulator.py", "weeks.csv"} <= {each.name for each in own.iterdir()}
    printed = capsys.readouterr()
    assert str(own / "case.toml") in printed.out and f"snapo check {own}" in printed.err


def test_new_overwrites_nothing(tmp_path, capsys):
    (tmp_path / "weeks.csv").write_text("mine")
    assert main(["new", "own", str(tmp_path)]) == 2
    assert "weeks.csv" in capsys.readouterr().err
    assert listing(tmp_path) == {"weeks.csv": b"mine"}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["new", "owm", "x"], ["'owm'", "own"]),
        (["new", "own", "x", "--size", "huge"], ["--size", "'huge'", "one example only"]),
        (["new", "own"], ["snapo new own DIR"]),
        (["check", "nowhere"], ["nowhere"]),
        (["report", "nowhere"], ["nowhere", "run.json"]),
        (["compare", "nowhere", "x"], ["nowhere"]),
    ],
)
def test_wrong_arguments_are_one_sentence(arguments, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1
    for name in named:
        assert name in printed.err, printed.err
    assert not list(tmp_path.iterdir())


# Mistakes, and keys for one run.


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ([], ["--simulator", "simulator:Reservoir"]),
        (["--simulator", "no_such_module:Mine"], ["no_such_module"]),
        (["--simulator", "simulator:Yours"], ["Yours"]),
        ([*SIMULATOR, "--set", "training.step=5"], ["training.step", "steps"]),
        ([*SIMULATOR, "--set", "training.steps=many"], ["training.steps", "quotation marks"]),
        ([*SIMULATOR, "--set", "training"], ["contract.inventory=2000"]),
        ([*SIMULATOR, "--out", "."], ["--out", "a separate folder"]),
    ],
)
def test_mistakes_are_found_before_any_work(more, named, own, monkeypatch, capsys):
    monkeypatch.chdir(own)
    capsys.readouterr()
    before = listing(own)
    assert main(["solve", ".", *more]) == 2
    printed = capsys.readouterr()
    for name in named:
        assert name in printed.err, printed.err
    after = listing(own)
    assert {name: after[name] for name in after if "__pycache__" not in name} == before


LONG = "x" * 300  # more than file systems take


@pytest.mark.parametrize(
    "arguments", [["check", LONG], ["solve", "CASE", "--out", LONG], ["report", LONG]]
)
def test_a_name_that_is_no_name_of_a_file_is_one_message(arguments, case, capsys):
    assert main([str(case) if word == "CASE" else word for word in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("snapo:") == 1 and "File name too long" in error


def test_json_prints_one_object_even_for_bad_input(case, capsys):
    (case / "curve.csv").unlink()
    assert main(["solve", str(case), "--json"]) == 2
    printed = capsys.readouterr()
    answer = json.loads(printed.out)
    assert answer["status"] == "bad-input"
    assert "curve.csv" in answer["message"]
    assert "curve.csv" in printed.err


# What the command asks for, and what it prints.


@pytest.fixture
def asked(monkeypatch):
    """What `solve` is asked for; it answers at once."""
    calls = []

    def solve(asked, tell, **options):
        calls.append((asked, options))
        print("a library prints")
        result = {"kind": "own", "status": "ok", "value": np.float64(12.5)}
        return result | {"standard_error": float("nan"), "run": options["out"]}

    monkeypatch.setattr(commands, "solve", solve)
    return calls


def test_solve_passes_on_what_was_asked(asked, tmp_path, capsys):
    options = ["--out", str(tmp_path), "--seed", "7", "--engine", "xla", "--reference", "--resume"]
    options += ["--policy", "before", "--seeds", "0,3", "--ladder", "--hedge", "--gamma"]
    assert main(["solve", "mine", *options, "--set", "a.b=1", *SIMULATOR]) == 0
    case, given = asked[0]
    assert case == (Path("mine"), ("a.b=1", "training.seed=7"), OWN.simulator)
    assert given == {
        "out": tmp_path,
        "engine": "xla",
        "reference": True,
        "ladder": True,
        "hedge": True,
        "gamma": True,
        "resume": True,
        "policy": Path("before"),
        "seeds": (0, 3),
        "workers": None,
    }
    assert "12.50" in capsys.readouterr().out


def test_solve_has_defaults(asked):
    assert main(["solve", "mine"]) == 0
    case, given = asked[0]
    assert case == (Path("mine"), (), None)
    bare = {"out": None, "engine": "auto", "reference": False, "ladder": False, "resume": False}
    bare |= {"hedge": False, "gamma": False}
    assert given == {**bare, "policy": None, "seeds": None, "workers": None}


def test_what_libraries_print_stays_off_stdout(asked, tmp_path, capsys):
    assert main(["solve", "mine", "--json", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert (result["value"], result["standard_error"]) == (12.5, None)
    assert result["run"] == str(tmp_path)
    assert "a library prints" in printed.err


def test_check_prints_its_lines(monkeypatch, capsys):
    monkeypatch.setattr(commands, "check", lambda asked, tell: ["fine"])
    assert main(["check", "mine"]) == 0
    assert capsys.readouterr().out == "fine\n"


# Runs.


def again(solved, out: Path) -> list[str]:
    """The command that goes on with the solved miniature, which has nothing left to do."""
    command = ["solve", str(solved("own") / "case"), "--out", str(out), "--resume", *SIMULATOR]
    return command + [part for each in OWN.assignments for part in ("--set", each)]


@pytest.fixture
def run(solved, tmp_path):
    return Path(shutil.copytree(solved("own") / "run", tmp_path / "run"))


def test_json_is_exactly_one_object(solved, run, capsys):
    before = json.loads((run / "result.json").read_text())
    assert main([*again(solved, run), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["value"] == before["value"] and result["run"] == str(run)
    assert set(before) <= set(result)


def test_a_person_reads_the_value_and_where_the_report_lies(solved, run, capsys):
    value = json.loads((run / "result.json").read_text())["value"]
    assert main(again(solved, run)) == 0
    printed = capsys.readouterr().out
    assert f"{value:,.2f}" in printed and str(run / "report.html") in printed


def test_a_run_compared_with_itself(run, capsys):
    assert main(["compare", str(run), str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "ok"


# The command line itself.


def run_python(*arguments: str) -> subprocess.CompletedProcess:
    source = str(Path(__file__).parents[2] / "src")
    environment = os.environ | {"PYTHONPATH": source}
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=environment, timeout=60
    )


@pytest.mark.parametrize("arguments", [("new",), ("schema", "control"), ("completion", "bash")])
def test_a_reader_that_stops_reading_is_no_fault(arguments):
    """As in `snapo schema control | head -1`: nothing is written about it."""
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "snapo", *arguments]
    with os.fdopen(write, "w") as closed:
        done = subprocess.run(command, stdout=closed, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, done.stderr) == (141, b"")


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
    [(["--help"], 0), (["solve", "--help"], 0), (["sovle"], 2),
     (["solve", "x", "--seed", "-1"], 2), (["solve", "x", "--simulator", "os"], 2), ([], 2)],
)  # fmt: skip
def test_help_and_wrong_arguments_import_nothing_heavy(arguments, code):
    done = run_python("-c", LIGHT.format(arguments))
    assert done.stdout.splitlines()[-1] == f"{code} []"
    assert "usage: snapo" in done.stdout + done.stderr


def test_the_package_runs_as_a_module():
    done = run_python("-m", "snapo", "--version")
    assert done.returncode == 0 and done.stdout.startswith("snapo ")


def test_help_answers_at_once():
    def seconds() -> float:
        began = time.perf_counter()
        assert run_python("-m", "snapo.cli.main", "--help").returncode == 0
        return time.perf_counter() - began

    # The best of five, since other work on the machine only ever adds.
    assert min(seconds() for _ in range(5)) < 0.3


STARTED = """
from snapo.cli.main import main
from jax._src import xla_bridge
print(main({!r}), xla_bridge.backends_are_initialized())
"""


def test_bad_input_is_found_before_jax_starts(case):
    """A case holds objects of the core, so reading loads JAX; but nothing is computed by it."""
    (case / "curve.csv").write_text("")
    done = run_python("-c", STARTED.format(["solve", str(case)]))
    assert done.stdout.splitlines()[-1] == "2 False"
    assert "curve.csv: the file is empty" in done.stderr


@pytest.mark.prove
@pytest.mark.parametrize(
    "package, extra, line",
    [
        ("pydantic", "cli", ["check", "CASE"]),
        ("jinja2", "cli", ["report", "RUN"]),
        ("aiohttp", "live", ["open", "RUN"]),
    ],
)
def test_a_missing_extra_is_one_line_with_the_command(package, extra, line, case, solved):
    run = str(solved("inventory") / "run")
    line = [{"CASE": str(case), "RUN": run}.get(word, word) for word in line]
    code = f"import sys; sys.modules[{package!r}] = None; from snapo.cli.main import main; "
    made = subprocess.run(
        [sys.executable, "-c", f"{code} sys.exit(main({line!r}))"], capture_output=True, text=True
    )
    assert made.returncode == 2 and made.stderr.count("\n") == 1, made.stderr
    assert package in made.stderr and f"pip install 'snapo[{extra}]'" in made.stderr


def test_a_polite_kill_is_an_interrupt():
    """The parts that are done are then reported, as on Ctrl-C."""
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), printed.stoppable():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_terminal_says_the_meaning_of_the_value():
    result = {"kind": "pharma", "status": "ok", "value": 0.925537, "meaning": "of all limits"}
    lines = printed.summary(result | {"verdict": "The recipe does better."}).splitlines()
    assert lines[1].split(maxsplit=2) == ["value", "0.925537", "of all limits"]
    assert "The recipe does better." in lines
