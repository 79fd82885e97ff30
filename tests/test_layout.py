"""The shape of the package: imports point up, no circles, files are one thought, nothing global."""

import ast
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import snapo

HOME = Path(snapo.__file__).parent
ROOT = HOME.parents[1]
FILES = sorted(HOME.rglob("*.py"))
MOST_FILES, MOST_LINES = 15, 400

# A part imports only what stands above it. `lanes` is a compiler on its own.
ORDER = [
    "lanes",
    "problem",
    "noise",
    "engine",
    "checker",
    "solver",
    "log",
    "gym",
    "case",
    "report",
    "study",
    "live",
    "book",
    "testing",
    "domains",
    "cli",
    "__main__",
]


def module(file: Path) -> tuple[str, ...]:
    """The dotted name of a file, as a tuple: ("snapo", "problem", "inputs")."""
    name = file.relative_to(HOME.parent).with_suffix("").parts
    return name[:-1] if name[-1] == "__init__" else name


MODULES = {module(file): file for file in FILES}


def imports(file: Path, late: bool = True) -> list[tuple[str, ...]]:
    """The modules that a file imports, relative names resolved; `late` ones in functions too."""
    return _imports(file)[late]


@cache
def _imports(file: Path) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Those when the file is imported, and all: each file is parsed once."""
    tree = ast.parse(file.read_text())
    return _resolved(file, _at_import(tree)), _resolved(file, ast.walk(tree))


def _resolved(file: Path, nodes: Iterable[ast.AST]) -> list[tuple[str, ...]]:
    package, found = module(file) if file.name == "__init__.py" else module(file)[:-1], []
    for node in nodes:
        if isinstance(node, ast.Import):
            found += (tuple(alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = (*base, *(node.module.split(".") if node.module else ()))
            names = ((*stem, alias.name) for alias in node.names)
            found += (name if name in MODULES else stem for name in names)
    return found


def _at_import(tree: ast.Module):
    """Statements that run when the module is imported; not those for type checkers alone."""
    found: list[ast.AST] = [tree]
    while found:
        node = found.pop()
        yield node
        for child in ast.iter_child_nodes(node):
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            checking = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)
            if not function and not checking:
                found.append(child)


def relative(file: Path) -> str:
    return str(file.relative_to(HOME))


def part(name: tuple[str, ...]) -> str:
    return name[1] if len(name) > 1 else ""


def test_imports_point_up():
    for file in FILES:
        mine = part(module(file))
        for name in imports(file) if mine else ():
            if name[:1] == ("snapo",) and part(name) and part(name) != mine:
                where = f"{relative(file)} imports {'.'.join(name)}"
                assert ORDER.index(part(name)) < ORDER.index(mine), where


def test_no_circles_between_files():
    """Depth first through the imports: a file that is met on its own way is a circle."""
    edges = {
        name: sorted({each for each in imports(file, late=False) if each in MODULES} - {name})
        for name, file in MODULES.items()
    }
    done: set[tuple[str, ...]] = set()

    def visit(name, way):
        assert name not in way, " -> ".join(".".join(each) for each in (*way, name))
        if name not in done:
            for each in edges[name]:
                visit(each, (*way, name))
            done.add(name)

    for name in edges:
        visit(name, ())


def test_the_compiler_knows_nothing_of_snapo():
    for file in FILES:
        if part(module(file)) == "lanes":
            assert not [n for n in imports(file) if n[0] == "snapo" and n[1:2] != ("lanes",)]


# The contracts of energy read the prices, the market and the basis of gas storage where they stand.
BUILDS_ON = {"energy": "gas_storage"}


def test_domains_do_not_import_each_other():
    for file in FILES:
        mine = module(file)[:3]
        if mine[1:2] == ("domains",) and len(mine) > 2:
            for name in imports(file):
                base = (*mine[:2], BUILDS_ON.get(mine[2], mine[2]))
                assert name[:2] != mine[:2] or len(name) < 3 or name[:3] in (mine, base), relative(
                    file
                )


def test_folders_are_small():
    for folder in {file.parent for file in FILES}:
        files = [each for each in folder.glob("*.py") if each.name != "__init__.py"]
        assert len(files) <= MOST_FILES, f"{folder.relative_to(HOME)} has {len(files)} files"


def test_no_torch_and_no_global_switch():
    for file in FILES:
        assert not [name for name in imports(file) if name[0] == "torch"], relative(file)
        text = file.read_text()
        assert "jax_enable_x64" not in text, f"{relative(file)} touches JAX's global switch"


def test_files_are_short_and_named_after_a_thought():
    for file in FILES:
        lines = len(file.read_text().splitlines())
        assert lines <= MOST_LINES, f"{relative(file)} has {lines} lines"
        assert file.stem not in ("utils", "helpers", "common", "misc"), relative(file)


def test_public_names_exist_and_stay_what_they_are():
    """Names load lazily: a submodule must not take the place of the function of its name."""
    for _ in range(2):
        for name in snapo.__all__:
            module = isinstance(getattr(snapo, name), type(ast))
            assert module == (name in snapo.MODULES), f"snapo.{name} is a module"


def test_the_readme_shows_the_example_that_runs():
    example = (ROOT / "examples" / "own_simulator.py").read_text()
    assert example.rstrip() in (ROOT / "README.md").read_text()
    assert len(example.splitlines()) <= 30


@pytest.mark.parametrize("name", snapo.MODULES)
def test_public_modules_can_be_imported_as_modules(name):
    """`from snapo.noise import Poisson` is what people write."""
    alone = (
        f"from snapo.{name} import *; import snapo, snapo.{name} as it; assert snapo.{name} is it"
    )
    subprocess.run([sys.executable, "-c", alone], check=True, timeout=60)
    found, attribute = import_module(f"snapo.{name}"), getattr(snapo, name)
    assert found is attribute and set(found.__all__) <= set(dir(found))
