"""What every domain's case format shares: one TOML file, plain files next to it, clear errors.

A case is data: nothing in it is executed, and the files that it names are in its folder. The
records here are NumPy and the standard library; pydantic checks the tables at this border.
"""

import datetime
import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args, get_origin

import pydantic
from pydantic import Field
from pydantic.fields import FieldInfo

from .error import CaseError, nearest

LARGEST = 1e36  # a number of a case, in size: training computes in single precision
LONGEST = 2_000  # characters of a text in a table
TOO_LARGE = f"no number of a case is larger than {LARGEST:g}"


@dataclass(frozen=True)
class TableContext:
    """A table of a case while it is read: names the place of a mistake, collects remarks.

    `path`: the keys to it, if they differ from its name in messages.
    """

    file: Path
    name: str
    notes: list[str]
    path: tuple[str | int, ...] | None = field(default=None, kw_only=True)

    @property
    def keys(self) -> tuple[str | int, ...]:
        """The keys that lead to the table from the top of the file."""
        if self.path is not None:
            return self.path
        return keys_of(self.name)

    def error(self, key: str, value: Any, allowed: str) -> CaseError:
        """A mistake in the value of `key`."""
        return CaseError(str(self.file), f"{self.name}.{key}", value, allowed)


def keys_of(name: str) -> tuple[str | int, ...]:
    """The keys that lead to a table of this name: "place[1].demand" is ("place", 1, "demand")."""
    parts = re.findall(r"\[(\d+)\]|([^.\[\]]+)", name)
    return tuple(int(row) if row else key for row, key in parts)


class CaseTable(pydantic.BaseModel):
    """A strict TOML table: no unknown keys, no conversions, no NaN or infinite numbers."""

    model_config = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )


# {name of a table: its format, or several of which a case has one}. "" is the whole file, "place[]"
# an array of tables, "units.*" a table of tables, "place[].demand" a table in each of an array.
Formats = Mapping[str, type[CaseTable] | Sequence[type[CaseTable]]]

Title = Annotated[str, Field(max_length=200)]
TITLE = "a text of at most 200 characters in quotation marks"
Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


AnyTable = TypeVar("AnyTable", bound=CaseTable)


def not_utf8(error: UnicodeDecodeError) -> str:
    """The sentence about a text file in another encoding, with the line and the byte."""
    raw = error.object
    line = raw.count(b"\n", 0, error.start) + 1
    return f"byte 0x{raw[error.start]:02x} on line {line} is not UTF-8; save the file as UTF-8"


class TableRead(NamedTuple):
    """A table of a case that was checked: its name in messages, its data, and its options.

    `options`: {key: the texts and truth values that it may have}, of keys with several.
    """

    name: str
    data: Any
    fields: Mapping[str, FieldInfo]
    options: Mapping[str, tuple[str | bool, ...]]


_tables_read: ContextVar[list[TableRead] | None] = ContextVar("tables read", default=None)


@contextmanager
def recorded_tables() -> Iterator[list[TableRead]]:
    """Collects every table that is checked inside of it."""
    tables: list[TableRead] = []
    before = _tables_read.set(tables)
    try:
        yield tables
    finally:
        _tables_read.reset(before)


def record_kinds(data: Any, name: str, key: str, kinds: Iterable[str]) -> None:
    """Records the values of a key that chooses the format of its table, such as `kind`."""
    if (tables := _tables_read.get()) is not None:
        tables.append(TableRead(name, data, {}, {key: tuple(kinds)}))


def options_of(annotation: Any) -> tuple[str | bool, ...]:
    """The strings and booleans that a type lists."""
    if annotation is bool:
        return (False, True)
    parts = get_args(annotation)
    if get_origin(annotation) is Literal:
        return tuple(part for part in parts if isinstance(part, str))
    if get_origin(annotation) in (list, dict, tuple):
        return ()
    return tuple(option for part in parts for option in options_of(part))


def parse(
    table: type[AnyTable],
    data: Any,
    file: str,
    name: str,
    notes: list[str] | None = None,
    path: tuple[str | int, ...] | None = None,
) -> AnyTable:
    """Checks the TOML table `data`, called `name` in messages; collects all of its mistakes.

    `notes`, `path`: as of a `TableContext`, for the readers of its keys.
    """
    if (tables := _tables_read.get()) is not None:
        fields = {field.alias or key: field for key, field in table.model_fields.items()}
        options = {key: options_of(field.annotation) for key, field in fields.items()}
        tables.append(TableRead(name, data, fields, options))
    if not isinstance(data, Mapping):
        raise CaseError(file, name, data, f"this must be a table, [{name}]")
    try:
        section = TableContext(Path(file), name, [] if notes is None else notes, path=path)
        read = table.model_validate(dict(data), context=section)
        _check_sizes(read, file, name)
        return read
    except pydantic.ValidationError as error:
        entries, meant = {}, set()
        for item in error.errors():
            key = str(item["loc"][0])
            # Of a union's several complaints about one key, the first is reported.
            entries.setdefault(key, _explain(table, data, file, name, item))
            if item["type"] == "extra_forbidden":
                meant.update(difflib.get_close_matches(key, table.model_fields, n=1))
        # A key that is missing because it is misspelt is one mistake, not two.
        entries = {key: entry for key, entry in entries.items() if key in data or key not in meant}
    first, *rest = entries.values()
    raise CaseError(first.file, first.where, first.value, first.allowed, rest)


def _check_sizes(table: CaseTable, file: str, name: str) -> None:
    """Numbers that would overflow and overlong texts are a mistake in every key."""
    for key in table.model_fields_set:
        where = f"{name}.{key}" if name else key
        message = f"allowed is {type(table).model_fields[key].description}"
        for item in _plain(getattr(table, key)):
            if isinstance(item, str) and len(item) > LONGEST:
                message += f"; no text of a case has more than {LONGEST:,} characters"
                raise CaseError(file, where, item, message)
            if isinstance(item, int | float) and abs(item) > LARGEST:
                raise CaseError(file, where, float(item), f"{message}; {TOO_LARGE}")


def _plain(value: Any) -> Iterator[Any]:
    """A value, or all those in its lists."""
    if isinstance(value, list):
        for item in value:
            yield from _plain(item)
    else:
        yield value


def _explain(table, data, file, name, item) -> CaseError:
    key = str(item["loc"][0])
    where = f"{name}.{key}" if name else key
    if item["type"] == "extra_forbidden":
        message = f"there is no such key; {nearest(key, table.model_fields)}"
        return CaseError(file, where, data[key], message)
    error = item.get("ctx", {}).get("error")
    if isinstance(error, CaseError):  # of a key's reader
        return error
    allowed = table.model_fields[key].description or item["msg"]
    if item["type"] == "missing":
        return CaseError(file, where, None, f"this key is missing; it is {allowed}")
    value = data[key]
    if isinstance(value, str) and table.model_fields[key].annotation is datetime.date:
        allowed += ", without quotation marks"
    if isinstance(value, float) and not math.isfinite(value):
        allowed += ", and finite"
    return CaseError(file, where, value, f"allowed is {allowed}")
