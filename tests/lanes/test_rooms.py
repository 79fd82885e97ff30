"""The rooms of the compiler: each imports earlier ones only, and nothing of snapo is needed."""

import ast
import subprocess
import sys
from pathlib import Path

from snapo import lanes

HOME = Path(lanes.__file__).parent
FILES = sorted(HOME.rglob("*.py"))
# `program` is above `emit`: a writer of code knows the values of a program, not the reverse.
ORDER = ["program", "emit", "curves", "rules", "body", "gradients", "machine"]
ALONE = {"machine"}  # needs no other room


def room(file: Path) -> str:
    name = file.relative_to(HOME).parts[0].removesuffix(".py")
    return name if name in ORDER else ""


def rooms_imported(file: Path) -> set[str]:
    """The rooms that a file imports from, by relative imports that start at the top."""
    nodes = [n for n in ast.walk(ast.parse(file.read_text())) if isinstance(n, ast.ImportFrom)]
    level = len(file.relative_to(HOME).parts)
    return {(n.module or "").split(".")[0] for n in nodes if n.level == level} & set(ORDER)


def test_a_room_imports_earlier_ones_only():
    for file in FILES:
        if mine := room(file):
            allowed = set() if mine in ALONE else set(ORDER[: ORDER.index(mine)])
            assert rooms_imported(file) <= allowed, file.relative_to(HOME)


def test_rooms_are_those_in_the_docstring():
    folders = {file.name for file in HOME.iterdir() if (file / "__init__.py").exists()}
    assert folders | {"body"} == set(ORDER) and (HOME / "body.py").exists()
    for name in ORDER:
        assert f"\n    {name} " in (lanes.__doc__ or "")


IMPORTED = """
import importlib, sys
for name in {names}:
    importlib.import_module(name)
parts = {{name.split(".")[1] for name in sys.modules if name.startswith("snapo.")}}
assert parts == {{"lanes"}}, parts
assert not [name for name in sys.modules if name.startswith("llvmlite")]
"""


def test_all_of_it_is_imported_without_snapo_and_without_llvmlite():
    names = [".".join(("snapo", *f.relative_to(HOME.parent).with_suffix("").parts)) for f in FILES]
    code = IMPORTED.format(names=[name.removesuffix(".__init__") for name in names])
    subprocess.run([sys.executable, "-c", code], check=True)
