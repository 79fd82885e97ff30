"""The modules of the package, and what each imports: shared by the figures of this folder.

Nothing is read before it is asked for: every process of the tests imports this module, and the
trees of all sources are millions of objects.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import snapo

HOME = Path(snapo.__file__).parent
Name = tuple[str, ...]  # ("snapo", "problem", "inputs")


def module(file: Path) -> Name:
    """The dotted name of a file, as a tuple."""
    name = file.relative_to(HOME.parent).with_suffix("").parts
    return name[:-1] if name[-1] == "__init__" else name


MODULES = {module(file): file for file in sorted(HOME.rglob("*.py"))}
PLAIN = [name for name, file in MODULES.items() if file.name != "__init__.py"]


@cache
def texts() -> dict[Name, str]:
    """{module: its source}."""
    return {name: file.read_text(encoding="utf-8") for name, file in MODULES.items()}


@cache
def trees() -> dict[Name, ast.Module]:
    """{module: its syntax tree}."""
    return {name: ast.parse(text) for name, text in texts().items()}


def imported(name: Name) -> Iterator[Name]:
    """All modules that a module imports, late and for type checkers too."""
    package = name[:-1] if name in PLAIN else name
    for node in ast.walk(trees()[name]):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = (*base, *(node.module.split(".") if node.module else ()))
            for alias in node.names:
                yield (*stem, alias.name) if (*stem, alias.name) in MODULES else stem
        elif isinstance(node, ast.Import):
            yield from (tuple(alias.name.split(".")) for alias in node.names)


@cache
def edges() -> dict[Name, set[Name]]:
    """{module: the modules of the package that it imports}."""
    return {name: {t for t in imported(name) if t in MODULES and t != name} for name in MODULES}


@cache
def importers() -> dict[Name, set[Name]]:
    """{module: those that import it}."""
    users: dict[Name, set[Name]] = defaultdict(set)
    for name, targets in edges().items():
        for target in targets:
            users[target].add(name)
    return users


def room(name: Name) -> str:
    """The top folder, or the domain."""
    if len(name) < 2:
        return "snapo"
    return "/".join(name[1:3]) if name[1] == "domains" and len(name) > 2 else name[1]


def short(name: Name) -> str:
    """The dotted name below the package."""
    return ".".join(name[1:])
