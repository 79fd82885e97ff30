"""Figures of the house: how much there is to read, and how many names there are for how much.

python -m tests.house.figures          every figure beside its limit
python -m tests.house.figures NAME     the entries of one figure
"""

import ast
import io
import keyword
import re
import sys
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .tree import MODULES, PLAIN, Name, edges, importers, room, short, texts, trees

HERE = Path(__file__).parent
SMALL = 70  # lines of a module that could be a part of the only one that imports it
FAMILIES = {"registry", "catalogue"}  # these import one file for each member: a unit, a process
READERS = {"get", "numbers", "table"}  # of a run or its folder, by a key
MEASURED = {
    "chapters", "sections", "report", "results", "parts", "live", "study", "figures"
}  # fmt: skip
NOT_CASES = {"lanes", "report", "live", "gym", "checker"}
RANGES = ("Field", "Positive", "NotNegative", "Share", "Rate", "Fraction", "Count")
STRINGS = (tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", -1))

FIGURES: dict[str, Callable[[], Sequence[str]]] = {}  # {name: the entries that are counted}


def figure(entries: Callable[[], Sequence[str]]) -> Callable[[], Sequence[str]]:
    """Registers a figure under the name of the function that lists its entries."""
    FIGURES[entries.__name__] = cache(entries)
    return FIGURES[entries.__name__]


def limits() -> dict[str, int]:
    """{figure: the most that it may be}."""
    return tomllib.loads((HERE / "limits.toml").read_text(encoding="utf-8"))


@figure
def lines() -> list[str]:
    """Lines of the package's source."""
    return [
        f"{short(name)} {i}"
        for name, text in texts().items()
        for i in range(len(text.splitlines()))
    ]


@figure
def files() -> list[str]:
    """Source files of the package."""
    return [short(name) for name in MODULES]


@figure
def empty_init_files() -> list[str]:
    """`__init__` files of one line or none."""
    return [short(n) for n in MODULES if n not in PLAIN and len(texts()[n].splitlines()) <= 1]


@figure
def single_importer() -> list[str]:
    """Modules that one other module imports, outside of families."""
    found = []
    for name in PLAIN:
        users = importers()[name]
        if len(users) == 1:
            (user,) = users
            if user[-1] not in FAMILIES and user in PLAIN:
                found.append(f"{short(name)} <- {short(user)}")
    return found


@figure
def single_importer_small() -> list[str]:
    """Those of them that are shorter than a chapter."""
    sizes = {short(name): len(text.splitlines()) for name, text in texts().items()}
    return [entry for entry in single_importer() if sizes[entry.split(" <- ")[0]] < SMALL]


@figure
def circles() -> list[str]:
    """Sets of modules that import one another, late imports and those for type checkers too."""
    names = list(MODULES)
    index = {name: i for i, name in enumerate(names)}
    pairs = [(index[name], index[t]) for name, targets in edges().items() for t in targets]
    rows, columns = np.array(pairs).T
    graph = csr_array((np.ones(len(pairs)), (rows, columns)), (len(names), len(names)))
    _, labels = connected_components(graph, connection="strong")
    groups = defaultdict(list)
    for name, label in zip(names, labels):
        groups[label].append(short(name))
    return [", ".join(group) for group in groups.values() if len(group) > 1]


@cache
def _defined() -> dict[str, set[Name]]:
    """{a class or an alias of a type: the modules that define it}."""
    found: dict[str, set[Name]] = defaultdict(set)
    for name, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].add(name)
            elif isinstance(node, ast.Assign) and isinstance(target := node.targets[0], ast.Name):
                called = isinstance(node.value, ast.Call) and "TypeVar" in ast.dump(node.value.func)
                alias = isinstance(node.value, ast.Subscript | ast.BinOp) or called
                if alias and target.id[:1].isupper() and not target.id.isupper():
                    found[target.id].add(name)
    return found


@figure
def names_with_several_meanings() -> list[str]:
    """Classes and aliases of one name in several modules."""
    return [
        f"{name}: {', '.join(sorted(map(short, where)))}"
        for name, where in _defined().items()
        if len(where) > 1
    ]


@figure
def names_with_several_meanings_across_rooms() -> list[str]:
    """Those of them in more than one room."""
    several = {name for name, where in _defined().items() if len(set(map(room, where))) > 1}
    return [x for x in names_with_several_meanings() if x.split(":")[0] in several]


@cache
def _read_keys() -> tuple[list[str], list[str]]:
    """The keys by which sections read what parts measured, and the keys of rows within."""
    keys, rows = [], []
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            text = _text(node.args[0]) if node.args else None
            if text is None or node.func.attr not in READERS:
                continue
            of = node.func.value
            if isinstance(of, ast.Name) and of.id in ("run", "self"):
                keys.append(text)
            elif node.func.attr == "get" and MEASURED & set(name[1:]):
                rows.append(text)
    return keys, rows


def _text(node: ast.expr) -> str | None:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "{}".join(str(x.value) for x in node.values if isinstance(x, ast.Constant))
    return None


@figure
def string_keys() -> list[str]:
    """Different keys between parts and sections."""
    return sorted(set(_read_keys()[0]))


@figure
def string_key_reads() -> list[str]:
    """Reads by such a key."""
    return _read_keys()[0]


@figure
def row_keys() -> list[str]:
    """Different keys of rows."""
    return sorted(set(_read_keys()[1]))


@figure
def ranges_written_twice() -> list[str]:
    """Numbers of a case whose range stands in an annotation and again in words."""
    found = []
    for name, tree in trees().items():
        if NOT_CASES & set(name[1:2]):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Call):
                described = any(each.arg == "description" for each in node.value.keywords)
                kind = ast.dump(node.annotation)
                if described and any(f"'{each}" in kind for each in RANGES):
                    found.append(f"{short(name)} {ast.unparse(node.target)}")
    return found


@cache
def _glossary() -> list[tuple[str, str, str, str]]:
    """(term, pattern of identifiers, pattern of prose, the standard term)."""
    rows = (HERE / "glossary.tsv").read_text(encoding="utf-8").splitlines()
    return [tuple(row.split("\t")[:4]) for row in rows if row and row[0] != "#"]  # pyright: ignore


@cache
def _tokens() -> tuple[Counter, str]:
    """How often every identifier stands in the package, and all of its prose."""
    identifiers, prose = Counter(), []
    for text in texts().values():
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.NAME and not keyword.iskeyword(token.string):
                identifiers[token.string] += 1
            elif token.type in STRINGS:
                prose.append(re.sub(r"\s+", " ", token.string))
    return identifiers, "\n".join(prose)


def _times(entries: Iterator[tuple[str, int]]) -> list[str]:
    return [term for term, count in entries for _ in range(count)]


@figure
def dialect_identifiers() -> list[str]:
    """Identifiers that the glossary replaces by the field's own."""
    identifiers, _ = _tokens()
    return _times(
        (term, sum(n for name, n in identifiers.items() if re.fullmatch(pattern, name)))
        for term, pattern, _, _ in _glossary()
        if pattern != "-"
    )


@figure
def dialect_prose() -> list[str]:
    """Words in docstrings, comments and messages that the glossary replaces."""
    _, prose = _tokens()
    return _times(
        (term, len(re.findall(pattern, prose)))
        for term, _, pattern, _ in _glossary()
        if pattern != "-"
    )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        for entry, times in Counter(FIGURES[sys.argv[1]]()).most_common():
            print(entry if times == 1 else f"{times:6,d} {entry}")
    else:
        for name, entries in FIGURES.items():
            print(f"{name:42} {len(entries()):7,d} of at most {limits().get(name, 0):7,d}")
