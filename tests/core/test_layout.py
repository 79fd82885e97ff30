"""The shape of the package: imports point up, files are one thought, nothing global is switched."""

import ast
from pathlib import Path

import pytest

import snapo

HOME = Path(snapo.__file__).parent
ROOT = HOME.parents[1]
FILES = sorted(HOME.rglob("*.py"))

# A module imports only what stands above it (modules of one line may not import each other).
ORDER = [
    ["inputs", "smooth"],
    ["simulator"],
    ["scenarios", "chain"],
    ["policy", "objective"],
    ["engine"],
    ["adjoint"],
    ["finite"],
    ["train", "evaluate"],
    ["checkpoint"],
    ["sensitivity"],
    ["certificate"],
    ["solution"],
    ["solver", "findings"],
    ["examine"],
    ["differences"],
    ["checker"],
]
LEVEL = {name: level for level, names in enumerate(ORDER) for name in names}
# Readers of cases stand beside the core; domains, reports and the command line come after it.
BESIDE = {"case", "csvfile", "dated", "objective_table"}
AFTER = {"runfolder", "domains", "report", "cli"}


def part(file: Path) -> str:
    """The part of the package that a file belongs to: `engine`, `train` …"""
    return file.relative_to(HOME).parts[0].removesuffix(".py")


def imports(file: Path):
    """(part or outside package, name) of every import, relative ones resolved."""
    package = file.relative_to(HOME.parent).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name.split(".")
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = [*base, *(node.module.split(".") if node.module else [])]
            if stem == ["snapo"]:
                yield from (["snapo", alias.name] for alias in node.names)
            else:
                yield stem


def relative(file: Path) -> str:
    return str(file.relative_to(HOME))


@pytest.mark.parametrize("file", [f for f in FILES if part(f) in LEVEL], ids=relative)
def test_imports_point_up(file):
    mine = part(file)
    for name in imports(file):
        if name[0] != "snapo" or len(name) < 2 or name[1] == mine:
            continue
        assert name[1] in LEVEL, f"{relative(file)}: the core imports {'.'.join(name)}"
        assert LEVEL[name[1]] < LEVEL[mine], f"{relative(file)}: {mine} stands above {name[1]}"


@pytest.mark.parametrize("file", [f for f in FILES if part(f) in BESIDE], ids=relative)
def test_readers_import_no_domain(file):
    assert not [n for n in imports(file) if n[0] == "snapo" and n[1:] and n[1] in AFTER]


def test_every_part_has_its_place():
    parts = {part(f) for f in FILES} - {"__init__"}
    assert parts == set(LEVEL) | BESIDE | AFTER


def test_domains_do_not_import_each_other():
    for file in FILES:
        if part(file) == "domains":
            mine = file.relative_to(HOME).parts[1]
            for name in imports(file):
                assert name[:2] != ["snapo", "domains"] or len(name) < 3 or name[2] == mine, (
                    relative(file)
                )


def test_no_torch_and_no_global_switch():
    for file in FILES:
        assert not [name for name in imports(file) if name[0] == "torch"], relative(file)
        text = file.read_text()
        assert "jax_enable_x64" not in text, f"{relative(file)} touches JAX's global switch"


def test_files_are_short_and_named_after_a_thought():
    for file in FILES:
        assert len(file.read_text().splitlines()) <= 400, f"{relative(file)} is over 400 lines"
        assert file.stem not in ("utils", "helpers", "common", "misc"), relative(file)


def test_public_names_exist_and_stay_what_they_are():
    """Names load lazily: a submodule must not take the place of the function of its name."""
    for _ in range(2):
        for name in snapo.__all__:
            assert not isinstance(getattr(snapo, name), type(ast)), f"snapo.{name} is a module"


def test_the_readme_shows_the_example_that_runs():
    example = (ROOT / "examples" / "own_simulator.py").read_text()
    assert example.rstrip() in (ROOT / "README.md").read_text()
    assert len(example.splitlines()) <= 30
