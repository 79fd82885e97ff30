"""The package as people install it: the wheel alone, in an environment without the repository."""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

import snapo

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.prove


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built by pip; the build tool comes from the package index where it is not here."""
    folder = tmp_path_factory.mktemp("wheel")
    alone = ["--no-build-isolation"] if find_spec("hatchling") else []
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder]
    built = subprocess.run([*pip, *alone, ROOT], capture_output=True, text=True, timeout=300)
    if built.returncode and "hatchling" in built.stderr and not alone:
        pytest.skip("hatchling is neither installed nor on a package index that can be reached")
    assert built.returncode == 0, built.stderr
    return next(folder.glob("snapo-*.whl"))


def test_it_holds_every_file_of_the_source_and_no_other(wheel):
    source = {
        path.relative_to(ROOT / "src").as_posix()
        for path in (ROOT / "src" / "snapo").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    packed = {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("snapo/")}
    assert packed == source
    assert "snapo/py.typed" in packed and "snapo/__init__.pyi" in packed


def test_a_case_is_written_and_solved_where_there_is_the_wheel_alone(wheel, tmp_path):
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps"]
    subprocess.run([*pip, wheel], check=True, timeout=120)
    where = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    site = Path(subprocess.run(where, check=True, capture_output=True, text=True).stdout.strip())
    # The libraries are those of this environment; files that end with .pth are not read there.
    (site / "libraries.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    given = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def run(*arguments) -> str:
        command = [python.with_name("snapo"), *map(str, arguments)]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=300, env=given, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert run("--version") == f"snapo {snapo.__version__}\n"
    from_wheel = [python, "-c", "import snapo; print(snapo.__file__)"]
    found = subprocess.run(from_wheel, capture_output=True, text=True, env=given, cwd=tmp_path)
    assert found.stdout.startswith(str(site))
    run("new", "own", "mine")
    few = ("training.steps=4", "training.paths=32", "evaluation.paths=256")
    changes = [part for each in few for part in ("--set", each)]
    solved = run("solve", "mine", "--simulator", "simulator:Reservoir", *changes, "--json")
    assert json.loads(solved)["status"] == "trained"
    assert (tmp_path / "mine" / "run" / "report.html").stat().st_size > 10_000
