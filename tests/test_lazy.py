"""Names that are loaded when first used are there: a module that moves leaves none behind."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from tests.study.fake import install

from snapo.cli.main import main
from snapo.problem.carry.save import KINDS, class_of
from snapo.problem.record import Input
from snapo.solver.derivatives.solution_file import about_sensitivities, arrays_of, save_named
from snapo.solver.derivatives.table import Sensitivities
from snapo.solver.statistics import Estimate
from snapo.study.domain import find, installed
from snapo.study.kind import Kind
from snapo.study.runs.store import folders


@pytest.mark.parametrize("name", ["snapo", "snapo.gym"])
def test_every_public_name_is_there(name):
    if name == "snapo.gym":
        pytest.importorskip("gymnasium")
    module = import_module(name)
    assert [each for each in dir(module) if not hasattr(module, each)] == []


@pytest.mark.parametrize("name", KINDS)
def test_every_class_that_a_file_of_a_policy_may_name_is_there(name):
    assert class_of(name).__name__ == name


@pytest.mark.parametrize("kind", installed())
def test_every_part_that_a_domain_names_is_there(kind):
    domain = find(kind, "here")
    if not isinstance(domain, Kind):
        pytest.skip("this domain loads its parts by itself")
    for name in filter(
        None, (domain.reader, domain.summary, domain.maker, domain.page, domain.timer)
    ):
        domain.loaded(name)
    assert all(folder.is_dir() for folder in domain.templates.values())


def test_a_case_is_checked_without_the_libraries_of_its_report():
    """They took 0.6 s of every `snapo check`, and of every process of a live page; `scipy.stats`
    took a third of `import snapo`."""
    code = (
        # Where dask is installed, pint imports it, and dask imports jinja2.
        "import sys; sys.modules['dask'] = None\n"
        "from snapo.study.domain import find, installed; from snapo.study.kind import Kind\n"
        "for domain in (find(kind, 'here') for kind in installed()):\n"
        "    isinstance(domain, Kind) and domain.loaded(domain.maker)\n"
        "print(*{'matplotlib', 'jinja2', 'scipy.stats'} & sys.modules.keys())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


SOLVER = "snapo.solver", "snapo.engine", "snapo.study.study", "snapo.report", "optax", "diffrax"
PICTURES = "scipy.stats", "matplotlib"
JAX = "jax", "jaxlib", "equinox", "jaxtyping", "scipy.special"


def loaded_by_checks(kinds: list[str], heavy: tuple[str, ...], folder: Path) -> str:
    """Which modules of `heavy` are loaded by `new` and `check` of each kind, one after the other."""
    code = (
        "import sys; from pathlib import Path; from snapo.cli.main import main\n"
        f"for kind in {kinds}:\n"
        f"    case = str(Path({str(folder)!r}) / kind)\n"
        "    assert main(['new', kind, case]) == main(['check', case]) == 0\n"
        f"    print('loaded by', kind, *(name for name in {heavy} if name in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = [line for line in run.stdout.splitlines() if line.startswith("loaded by")]
    assert len(lines) >= len(kinds)
    return " ".join(line for line in lines if len(line.split()) > 3)


def test_cases_are_read_and_checked_without_jax(tmp_path):
    """JAX, Equinox and the special functions of SciPy took two thirds of every check, solver and
    compiler 1.7 of the 3.0 processor seconds of a gas storage. The simulator of a user is examined
    by running it."""
    kinds = [kind for kind in installed() if kind != "own"]
    assert len(kinds) >= 9 and not loaded_by_checks(kinds, SOLVER + PICTURES + JAX, tmp_path)


@pytest.fixture
def runs(tmp_path, monkeypatch, capsys):
    """A case with two runs that have a value and a sensitivity."""
    install(monkeypatch, fake="tests.study.fake:DOMAIN")
    (tmp_path / "case.toml").write_text('kind = "fake"\nnumbers = [1, 2, 4]\n')
    for number in (4, 6):
        assert main(["solve", str(tmp_path), "--set", f"numbers=[1, 2, {number}]"]) == 0
    capsys.readouterr()
    for number, run in enumerate(folders(tmp_path)):
        estimate = Estimate(np.arange(4.0) + number)
        table = Sensitivities({"price": Input(30.0, "EUR")}, {"price": estimate})
        about = about_sensitivities(table)
        save_named(run / "solution.npz", arrays_of({}, table), about)
    yield tmp_path, *folders(tmp_path)
    installed.cache_clear()


@pytest.mark.parametrize("command", ["runs", "compare", "cache"])
def test_what_was_computed_is_shown_without_jax(runs, command):
    """It took nine tenths of these commands. Intervals need a special function of SciPy."""
    case, *both = map(str, runs)
    words = [command, *{"runs": [case], "compare": both, "cache": []}[command]]
    heavy = {*JAX, *SOLVER, *PICTURES} - {"snapo.solver", "snapo.report", "scipy.special"}
    code = (
        f"import sys; from snapo.cli.main import main; assert main({words}) == 0\n"
        f"print('loaded', *({heavy} & sys.modules.keys()))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    *answer, last = run.stdout.splitlines()
    assert len(answer) >= 2 and last == "loaded"
    assert command != "compare" or any(
        line.split()[:3] == ["price", "1.5", "2.5"] for line in answer
    )
