"""A domain in a package of someone else's: installed with pip, it has every command."""

import json
import os
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

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


# Several commands in one process, as each of its own would import all libraries again.
COMMANDS = """
import contextlib, io, json, sys
from snapo.cli.main import main
answers = []
for command in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(command)
        except SystemExit as end:
            code = end.code
    answers.append([code, out.getvalue(), err.getvalue()])
print(json.dumps(answers))
"""


class Answer(NamedTuple):
    """What a command returns, and what it prints."""

    code: int
    out: str
    err: str


def snapo(python: Path, *commands: list[str]) -> list[Answer]:
    given = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    line = [python, "-c", COMMANDS, json.dumps(commands)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=400, env=given)
    assert done.returncode == 0, done.stderr
    return [Answer(*each) for each in json.loads(done.stdout)]


def test_every_command_knows_the_new_kind(environment, tmp_path):
    case = str(tmp_path / "shop")
    listed, new, checked, wrong, solved = snapo(
        environment,
        ["new"],
        ["new", "newsvendor", case],
        ["check", case],
        ["check", case, "--set", "shop.day=3"],
        ["solve", case, "--reference", "--json"],
    )
    assert "newsvendor    orders for a shop with uncertain demand" in listed.out
    assert new.code == 0
    # exp(0.3 z - 0.045) at the 90 % quantile z = 1.2816 is 1.404.
    assert "the best rule orders up to 140.4 pieces" in checked.out, checked.err
    assert wrong.code == 2 and "the nearest known key is days" in wrong.err
    assert solved.code == 0, solved.err
    result = json.loads(solved.out)
    best = result["references"]["best_rule"]
    # The rule of the theory is the optimum; a network comes within half a per cent of it.
    assert best * 0.995 < result["value"] < best + 5 * result["standard_error"]
    report = tmp_path / "shop" / "run" / "report.html"
    page = report.read_bytes()
    report.unlink()
    again, timed = snapo(environment, ["report", str(report.parent)], ["bench", "newsvendor"])
    assert again.code == 0 and timed.code == 2
    assert report.read_bytes() == page
    text = page.decode()
    assert "Best rule" in text and "of a customer who waits overnight" in text
