"""Names that are loaded when first used are there: a module that moves leaves none behind."""

import subprocess
import sys
from importlib import import_module

import pytest

from snapo.problem.carry.save import KINDS, class_of
from snapo.study.domain import find, installed
from snapo.study.kind import Kind


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


def test_cases_are_checked_without_solver_and_compiler(tmp_path):
    """They took 1.7 of the 3.0 processor seconds of `snapo check` of a gas storage, 8 of the 10 of
    a fund. A case of a user's own simulator is examined by running it."""
    code = (
        "import sys; from pathlib import Path; from snapo.cli.main import main\n"
        "heavy = 'snapo.solver', 'snapo.engine', 'snapo.study.study', 'snapo.report', 'optax', "
        "'diffrax', 'scipy.stats', 'matplotlib'\n"
        "for kind in 'gas-storage', 'control', 'inventory', 'plant', 'pharma', 'pension':\n"
        f"    case = str(Path({str(tmp_path)!r}) / kind)\n"
        "    assert main(['new', kind, case]) == main(['check', case]) == 0\n"
        "    from jax._src.xla_bridge import backends_are_initialized\n"
        "    loaded = [name for name in heavy if name in sys.modules]\n"
        "    print('loaded by', kind, *loaded, *['XLA'] * backends_are_initialized())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = [line for line in run.stdout.splitlines() if line.startswith("loaded by")]
    assert lines and [line for line in lines if len(line.split()) > 3] == []
