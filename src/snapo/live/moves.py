"""Moved inputs and choices of a run on the page, with or without a policy, and the files of the
moved case.

Choices are keys of a case with a list of allowed texts, or switches; the table of a key declares
the list. Every option is tested; an option that contradicts other keys of the case is not offered.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from snapo.case.error import CaseError
from snapo.case.table import keys_of, recorded_tables
from snapo.problem.inputs import Input
from snapo.solver import statistics
from snapo.study.positions import ChangedCase, InputPositions, movable
from snapo.study.positions.files import Files, Key
from snapo.study.study import DisplayedValue, Recalculated, Study

from .terms import described, handles

OWN = ("title", "name", "label")  # keys by which the row of a table names itself


def title(tables: Mapping[str, Any], key: Key) -> str:
    """The title of a key: ("parameters", 0, "distribution", "kind") becomes "Granule size:
    distribution", if the first row of `parameters` has this name, and ("units", "mill", "kind")
    becomes "Mill: kind".
    """
    rows = [i for i, part in enumerate(key) if isinstance(part, int)]
    if rows:
        at = rows[-1]
        user, rest = _row(tables, key[: at + 1]), key[at + 1 :]
    elif len(key) > 1:
        at = 1 if len(key) > 2 and _family(tables.get(str(key[0]))) else 0
        user, rest = capital(_spaced(key[at])), key[at + 1 :]
    else:
        user, rest = "", key
    if len(rest) > 1 and rest[-1] == "kind":
        rest = rest[:-1]
    metadata = ", ".join(map(_spaced, rest))
    return f"{user}: {metadata}" if user else capital(metadata)


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _spaced(part: str | int) -> str:
    return str(part).replace("_", " ")


def _row(tables: Any, path: Key) -> str:
    """The name in a row of an array of tables; if it has none, a text such as "Parameter 2"."""
    for part in path:
        tables = tables[part]
    by_name = [tables[key] for key in OWN if isinstance(tables.get(key), str) and tables[key]]
    *_, table, position = path
    return (
        by_name[0]
        if by_name
        else f"{capital(_spaced(table)).removesuffix('s')} {int(position) + 1}"
    )


def _family(table: Any) -> bool:
    """Whether a table contains only tables with names, such as [units]."""
    return isinstance(table, Mapping) and all(isinstance(x, Mapping) for x in table.values())


Tried = Callable[[Files], Any]
LEFT = ("title", "purpose", "kind", "report", "training", "evaluation", "policy", "goal")
MAX_KEYS, MAX_WORDS = 60, 12


def tables(table: Mapping[str, Any], path: Key) -> Iterator[tuple[Key, Mapping[str, Any]]]:
    """Every table, including tables in tables and in rows of tables."""
    yield path, table
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from tables(value, (*path, key))
        elif isinstance(value, list):
            for i, item in enumerate(value):
                if isinstance(item, Mapping):
                    yield from tables(item, (*path, key, i))


class MenuChoice(NamedTuple):
    """A key, its value in the run (or its default), and all allowed values.

    `title`: the key as text, "Granule size: distribution".
    """

    name: str
    key: Key
    value: str | bool
    allowed: Sequence[str | bool]
    title: str


def choices(files: Files, bumped: Tried) -> list[MenuChoice]:
    """Every key of the case that can have more than one value; `bumped` reads a case, or raises
    `CaseError`."""
    menus = []
    options = _options(files, bumped)
    stated = [key for key in _keys(files) if key in options]
    for key in [*stated, *(key for key in options if key not in stated)][:MAX_KEYS]:
        value, text = options[key]
        others = [word for word in text if word != value and _holds(files, key, word, bumped)]
        if others:
            name = ".".join(str(part + 1 if isinstance(part, int) else part) for part in key)
            menus.append(MenuChoice(name, key, value, [value, *others], title(files.tables, key)))
    return menus


def case_with(files: Files, available: Sequence[MenuChoice], requested: Mapping[str, Any]) -> Files:
    """The case with new values of these keys.

    **Raises:** `CaseError` for an unknown choice, or a value that it cannot have.
    """
    by_name = {item.name: item for item in available}
    for name, value in requested.items():
        choice = by_name.get(name)
        if choice is None:
            raise CaseError(name, "", None, "there is no such choice")
        if not any(type(entry) is type(value) and entry == value for entry in choice.allowed):
            message = f"it must be {' or '.join(map(str, choice.allowed))}"
            raise CaseError(name, "", value, message)
        files = files.with_value(choice.key, value)
    return files


def _keys(files: Files) -> Iterator[Key]:
    """All keys of the case, in its order."""
    for path, table in tables(files.tables, ()):
        yield from ((*path, key) for key in table)


def _options(files: Files, bumped: Tried) -> dict[Key, tuple[str | bool, list[str | bool]]]:
    """{key: its value, or its default if the case omits it, and all its possible values}."""
    with recorded_tables() as read:
        bumped(files)
    paths = {id(table): key_path for key_path, table in tables(files.tables, ())}
    ways = set(paths.values())
    menus: dict[Key, tuple[str | bool, list[str | bool]]] = {}
    for table in read:
        path = paths.get(id(table.data), keys_of(table.name))  # a reader may hand on a copy
        left_out = table.data == {} and len(path) == 1 and path[0] not in files.tables
        if not (path in ways or left_out) or (path and path[0] in LEFT):
            continue
        for key, options in table.options.items():
            default = table.fields[key].default if key in table.fields else None
            value = table.data.get(key, default)
            text = [x for x in dict.fromkeys(options) if type(x) is type(value)][:MAX_WORDS]
            if value in text and len(text) > 1 and (path or key not in LEFT):
                menus[(*path, key)] = value, text
    return menus


def _holds(files: Files, key: Key, value: str | bool, bumped: Tried) -> bool:
    try:
        bumped(files.with_value(key, value))
    except CaseError:
        return False
    return True


InputValues = Mapping[str, np.ndarray]
SelectedChoices = Mapping[str, str | bool]  # {key: another value}
Rebuild = Callable[[Any], Study]
NONE: SelectedChoices = {}


class WhatIf:
    """A run whose inputs can be moved.

    - `study`: the study of the run; `rebuild`: makes the study of a changed case.
    - `slopes`: {input: d value / d number, flat}; empty if none are known.
    """

    def __init__(
        self, study: Study, inputs: Mapping[str, Input], positions: InputPositions, rebuilt: Rebuild
    ):
        self.study, self.positions, self.rebuild = study, positions, rebuilt
        self.inputs_by_name = movable(inputs, positions.case)
        self.slopes: dict[str, np.ndarray] = {}

    @abstractmethod
    def stages(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> Iterator[tuple[str, Any]]:
        """Yields the page's tables at these numbers and choices as pairs (name, table).

        **Raises:** `CaseError` if the reader of the case refuses them.
        """

    def afterwards(self) -> Iterator[tuple[str, Any]]:
        """Yields, after all of `stages`, (name, table) for the tables that can wait until the user
        stops."""
        yield from ()

    @cached_property
    def choices(self) -> list[MenuChoice]:
        """The keys of the case that have a list of allowed values."""
        return choices(self.positions.files, self.positions.reread)

    def case_at(self, values: InputValues, selected: SelectedChoices = NONE) -> ChangedCase:
        """The case with these numbers and choices."""
        files = case_with(self.positions.files, self.choices, selected) if selected else None
        return self.positions.case_at(self.changed(values), files)

    @abstractmethod
    def shares(self, values: InputValues, selected: SelectedChoices = NONE) -> np.ndarray:
        """The parts of the value from independent groups of paths."""

    def explained(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> list[dict[str, Any]]:
        """Explains the change of the value. All choices are changed first, together; then one input
        after another is moved, on the same paths. If the case refuses the move of an input without
        the move of the next input, both are moved together.
        """
        moves = [(list(selected), {})] if selected else []
        moves += [([name], {name: new}) for name, new in self.changed(values).items()]
        rows, names, moved, before = [], [], {}, self.shares({})
        for k, (labels, new) in enumerate(moves):
            names, moved = [*names, *labels], moved | new
            try:
                now = self.shares(moved, selected)
            except CaseError:
                if k + 1 == len(moves):
                    raise
                continue
            rows.append(explained_by(names, before, now))
            names, before = [], now
        return rows

    @abstractmethod
    def counted(self) -> dict[str, int]:
        """The numbers of paths for the "value" and for other tables."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Keys of `[evaluation]` with which `snapo solve` reproduces the page."""

    def headline(self, value: float) -> DisplayedValue | None:
        """The value as the domain shows it, at the inputs that were valued last; None if the domain
        shows it unchanged."""
        return None

    def source(self, name: str) -> str:
        """The source of the run's reported derivative; "" if it is unknown."""
        return ""

    def inputs(self) -> list[dict[str, Any]]:
        """All inputs of the case, as the page shows them."""
        return [
            described(name, values, self.slopes.get(name), self.source(name))
            for name, values in self.inputs_by_name.items()
        ]

    def units(self) -> dict[str, Any]:
        """`unit` of the value; `units` and `names` of states, actions and outputs, where they are
        known."""
        about = self.study.about
        tables = {key: about.get(key) for key in ("units", "names")}
        tables = {key: x if isinstance(x, Mapping) else {} for key, x in tables.items()}
        return {"unit": about.get("value_unit", ""), **tables}

    def changed(self, values: InputValues) -> dict[str, np.ndarray]:
        """The inputs that differ from the inputs of the run, in the shapes of these inputs.

        **Raises:** `CaseError` for a name that is not an input, or numbers that do not fit.
        """
        changes = {}
        for name, value in values.items():
            inputs = self.inputs_by_name.get(name)
            if inputs is None:
                raise CaseError(name, "", None, "there is no such input")
            new = np.asarray(value, np.float64)
            if new.size != inputs.value.size or not np.isfinite(new).all():
                message = f"it must be {inputs.value.size} finite numbers"
                raise CaseError(name, "", None, message)
            new = new.reshape(inputs.value.shape)
            if not np.array_equal(new, inputs.value):
                changes[name] = new
        return changes

    def files(self, values: InputValues, selected: SelectedChoices = NONE) -> Files:
        """The files of the case with these numbers, so that `snapo solve` reproduces the page."""
        files = self.case_at(values, selected).files.without(self.study.checks)
        table = dict(files.tables.get("evaluation", {})) | self.settings()
        return files.with_value(("evaluation",), table)


def explained_by(names: Sequence[str], before: np.ndarray, now: np.ndarray) -> dict[str, Any]:
    """A step of a change: the names of the moved inputs, and the change of the value."""
    change = statistics.of_shares(now - before)
    return {"names": list(names), "change": change.value, "error": change.standard_error}


EXACT = {"low": None, "high": None}  # a derivative without noise has no interval


class Recalculation(WhatIf):
    """A run without training, whose domain calculates its figures at moved inputs."""

    def __init__(
        self, study: Study, values: Recalculated, positions: InputPositions, rebuilt: Rebuild
    ):
        super().__init__(study, values.inputs_by_name, positions, rebuilt)
        self.values, self.paths = values, 0
        self._variants: dict[str, Recalculated] = {}
        self._base: np.ndarray | None = None

    def counted(self) -> dict[str, int]:
        return {"value": self.paths}

    def settings(self) -> dict[str, Any]:
        return {}

    def stages(
        self, values: InputValues, selected: SelectedChoices = NONE
    ) -> Iterator[tuple[str, Any]]:
        """The stages of the domain: the value, with its change from the run."""
        if self._base is None and (values or selected):
            next(self.stages({}))
        changed, case = self.changed(values), self.case_at(values, selected).case
        for name, table in self._of(case, selected).stages(case):
            if name == "value":
                yield name, self._value(table, bool(changed or selected))
            elif name == "deltas":
                yield name, [self._by_handle(row) for row in table]
            else:
                yield name, table

    def shares(self, values: InputValues, selected: SelectedChoices = NONE) -> np.ndarray:
        case = self.case_at(values, selected).case
        table = next(self._of(case, selected).stages(case))[1]
        return statistics.shares(np.asarray(table["kept"]), None)

    def _of(self, case: Any, selected: SelectedChoices) -> Recalculated:
        """The calculation for these choices, which is made once for each combination."""
        if not selected:
            return self.values
        key = repr(sorted(selected.items()))
        if key not in self._variants:
            made = self.rebuild(case).recalculated
            assert made is not None
            self._variants[key] = made()
        return self._variants[key]

    def _value(self, table: dict[str, Any], changed: bool) -> dict[str, Any]:
        """The value, and how it differs from the run's on the same paths."""
        selected = np.asarray(table.pop("kept"))
        table.pop("outputs", None)  # the page has them as a section
        self._base = selected if self._base is None else self._base
        self.paths = table["paths"]
        change = statistics.mean(selected - self._base)
        return table | {
            "change": change.value if changed else 0.0,
            "change_error": change.standard_error if changed else 0.0,
        }

    def _by_handle(self, row: dict[str, Any]) -> dict[str, Any]:
        """Derivatives with respect to groups of numbers that move together."""
        numbers = [item["value"] for item in row["rows"]]
        rows = [
            {"label": label, "value": sum(numbers[i] for i in at), **EXACT}
            for label, at in handles(self.inputs_by_name[row["input"]])
        ]
        return row | {"rows": rows}
