"""The names that a function reads in addition to its arguments, from its bytecode."""

import dis
from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from types import CodeType
from typing import NamedTuple

LOADS = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")
CELLS = ("LOAD_DEREF", "LOAD_CLASSDEREF", "LOAD_FROM_DICT_OR_DEREF")
MEMBERS = ("LOAD_ATTR", "LOAD_METHOD", "LOAD_SUPER_ATTR", "IMPORT_FROM")
# These add to a container, and return nothing of it.
ADDING = ("append", "appendleft", "add", "extend", "insert")
CONTAINERS = (list, set, deque)
# With these a function reads more than its names show: names that are made, files, the environment.
UNSEEN = frozenset(
    (
        *("eval", "exec", "globals", "locals", "__import__", "import_module"),
        *("open", "read_text", "read_bytes", "load", "loads", "loadtxt", "genfromtxt", "fromfile"),
        *(
            "memmap",
            "read_csv",
            "read_excel",
            "read_json",
            "read_parquet",
            "read_pickle",
            "urlopen",
        ),
    )
)
MADE = frozenset(("getattr", "vars"))  # by these, attributes by names that are made


class Names(NamedTuple):
    """The names in a function and in the functions inside it.

    - `read`: globals and enclosing variables; `added`: those to which the code only adds.
    - `written`: globals that the code sets.
    - `members`: attributes, and every string that may be the name of one.
    - `modules`: the imported modules, with the level of a relative import.
    - `made`: whether the code reads attributes of other objects by names that are made at run time.
    - `unseen`: whether it reads anything for which its code has no name.
    """

    read: frozenset[str]
    added: frozenset[str]
    written: frozenset[str]
    members: frozenset[str]
    modules: frozenset[tuple[int, str]]
    made: bool
    unseen: bool


@lru_cache(4096)
def names(code: CodeType) -> Names:
    """All names in a function's code."""
    read, added, written, members, modules = set(), set(), set(), set(), set()
    for item in _codes(code):
        steps, level = list(dis.get_instructions(item)), 0
        for step, after in zip(steps, [*steps[1:], None]):
            name, kind = step.argval, step.opname
            if kind in LOADS or kind in CELLS:
                adds = after is not None and after.opname in MEMBERS and after.argval in ADDING
                (added if adds else read).add(name)
            elif kind == "STORE_GLOBAL":
                written.add(name)
            elif kind in MEMBERS:
                members.add(name)
            elif kind == "IMPORT_NAME":
                modules.add((level, name))
            elif kind.startswith("LOAD_") and type(name) is int:
                level = name  # the last whole number before an import is its level
        members |= {x for x in item.co_consts if isinstance(x, str) and x.isidentifier()}
    made, unseen = (not entry.isdisjoint(read | members) for entry in (MADE, UNSEEN))
    only_added = frozenset(added - read)
    sets = frozenset(written), frozenset(members), frozenset(modules)
    return Names(frozenset(read), only_added, *sets, made, unseen)


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for item in code.co_consts:
        if isinstance(item, CodeType):
            yield from _codes(item)
