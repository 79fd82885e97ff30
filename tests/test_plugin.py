"""A domain in a package of someone else's: installed with pip, it has every command."""

import json
import os
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PLUGIN = ROOT / "examples" / "plugin"

pytestmark = pytest.mark.prove


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> Path:
    """The Python of a fresh environment with the plugin; the libraries are those of this one."""
    folder = tmp_path_factory.mktemp("plugin")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    python = folder / "venv" / "bin" / "python"
    where = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    site = Path(subprocess.run(where, check=True, capture_output=True, text=True).stdout.strip())
    (site / "here.pth").write_text(f"{ROOT / 'src'}\n{sysconfig.get_path('purelib')}\n")
    # The build tool comes from the package index, where it is not installed here.
    alone = ["--no-build-isolation"] if find_spec("hatchling") else []
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps"]
    built = subprocess.run([*pip, *alone, PLUGIN], capture_output=True, text=True, timeout=300)
    if built.returncode and "hatchling" in built.stderr and not alone:
        pytest.skip("hatchling is neither installed nor on a package index that can be reached")
    assert built.returncode == 0, built.stderr
    return python


def snapo(python: Path, *arguments) -> subprocess.CompletedProcess:
    given = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [python, "-m", "snapo.cli.main", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=400, env=given)


def test_every_command_knows_the_new_kind(environment, tmp_path):
    listed = snapo(environment, "new")
    assert "newsvendor    orders for a shop with uncertain demand" in listed.stdout
    case = tmp_path / "shop"
    assert snapo(environment, "new", "newsvendor", case).returncode == 0
    checked = snapo(environment, "check", case)
    # exp(0.3 z - 0.045) at the 90 % quantile z = 1.2816 is 1.404.
    assert "the best rule orders up to 140.4 pieces" in checked.stdout, checked.stderr
    wrong = snapo(environment, "check", case, "--set", "shop.day=3")
    assert wrong.returncode == 2 and "the nearest known key is days" in wrong.stderr
    solved = snapo(environment, "solve", case, "--reference", "--json")
    assert solved.returncode == 0, solved.stderr
    result = json.loads(solved.stdout)
    best = result["references"]["best_rule"]
    # The rule of the theory is the optimum; a network comes within half a per cent of it.
    assert best * 0.995 < result["value"] < best + 5 * result["standard_error"]
    report = case / "run" / "report.html"
    page = report.read_bytes()
    report.unlink()
    assert snapo(environment, "report", case / "run").returncode == 0
    assert report.read_bytes() == page
    text = page.decode()
    assert "Best rule" in text and "of a customer who waits overnight" in text
    assert snapo(environment, "bench", "newsvendor").returncode == 2
