"""The common part of the case formats of all domains: one TOML file with plain files next to it.

A case is data: nothing in it is executed, and the files that it names are in its folder. The
records consist of NumPy arrays and standard types; pydantic is used only to check the tables.
"""

import datetime
import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import pydantic
from pydantic import Field
from pydantic.fields import FieldInfo

from .error import CaseError, nearest

LARGEST = 1e36  # a number of a case, in size: training computes in single precision
LONGEST = 2_000  # characters of a text in a table
TOO_LARGE = f"no number of a case is larger than {LARGEST:g}"


class Range(NamedTuple):
    """The numbers from `low` to `high`; messages and documentation show its text.

    - `endpoints`: "[)" if the upper endpoint is excluded, "(]" the lower one, "()" both.
    - `note`: text that follows, such as ": the mean of ln S".
    - `noun`: the noun for a number of the range; "" means "a number", or "a whole number" for
      integers.
    """

    low: float = -math.inf
    high: float = math.inf
    endpoints: str = "[]"
    note: str = ""
    noun: str = ""

    def contains(self, number: float) -> bool:
        """Whether a number is in the range (NaN is not)."""
        above = self.low < number if self.endpoints[0] == "(" else self.low <= number
        return above and (number < self.high if self.endpoints[1] == ")" else number <= self.high)

    @property
    def closed(self) -> tuple[float, float]:
        """The smallest and the largest number of the range."""
        low, high = self.low, self.high
        low = math.nextafter(low, math.inf) if self.endpoints[0] == "(" else low
        return low, math.nextafter(high, -math.inf) if self.endpoints[1] == ")" else high

    def __str__(self) -> str:
        noun = self.noun or "a number"
        digits = ".10g" if "calendar year" in self.noun else ",.10g"
        low, high = format(self.low, digits), format(self.high, digits)
        if self.low == -math.inf and self.high == math.inf:
            text = noun
        elif self.low == -math.inf:
            text = f"{noun} {'below' if self.endpoints[1] == ')' else 'of at most'} {high}"
        elif self.high == math.inf:
            text = f"{noun} {'above' if self.endpoints[0] == '(' else 'of at least'} {low}"
        elif self.endpoints == "()":
            text = f"{noun} between {low} and {high}"
        elif self.endpoints == "[)":
            text = f"{noun} of at least {low} and below {high}"
        elif self.endpoints == "(]":
            text = f"{noun} above {low}, at most {high}"
        else:
            text = f"{noun} from {low} to {high}"
        return text + self.note

    @property
    def of_integers(self) -> str:
        """The text of the integers from `low` to `high`."""
        end = "or more" if self.high == math.inf else f"to {self.high:,}"
        return f"{self.noun or 'a whole number'}, {self.low:,} {end}{self.note}"

    def json(self) -> dict[str, Any]:
        """The range as keys of a JSON schema."""
        return pydantic.TypeAdapter(Annotated[float, self]).json_schema()

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        lower = "gt" if self.endpoints[0] == "(" else "ge"
        upper = "lt" if self.endpoints[1] == ")" else "le"
        pairs = (lower, self.low), (upper, self.high)
        return handler(source) | {key: number for key, number in pairs if math.isfinite(number)}


@dataclass(frozen=True)
class TableContext:
    """A table of a case while it is read: names the position of a mistake and collects notes.
    `path`: the keys that lead to the table, if they differ from its name in messages.
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

    def nested(self, table: "type[AnyTable]", data: Any, key: str) -> "AnyTable":
        """The table `key` within this one, checked as in `parse`."""
        return parse(table, data, str(self.file), f"{self.name}.{key}", self.notes)


def keys_of(name: str) -> tuple[str | int, ...]:
    """The keys that lead to a table of this name: "place[1].demand" is ("place", 1, "demand")."""
    parts = re.findall(r"\[(\d+)\]|([^.\[\]]+)", name)
    return tuple(int(row) if row else key for row, key in parts)


def allowed_text(annotation: Any, metadata: Iterable[Any] = ()) -> str | None:
    """The values of a type as text. The type is a `Range` of numbers, a few texts, or a union of
    such types; None for any other type."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return allowed_text(parts[0], parts[1:])
    for item in metadata:
        if isinstance(item, Range):
            return item.of_integers if annotation is int else str(item)
        if isinstance(item, FieldInfo) and item.description:
            return item.description
    if annotation is bool:
        return "true or false"
    if origin is Literal:
        *first, last = [f'"{part}"' if isinstance(part, str) else str(part) for part in parts]
        return f"{', '.join(first)} or {last}" if first else last
    if origin in (Union, UnionType):
        texts = [allowed_text(part) for part in parts if part is not NoneType]
        return ", or ".join(filter(None, texts)) if all(texts) else None
    return None


def doc(meaning: str, default: Any = ..., allowed: str = "", **more: Any) -> Any:
    """A field of a `CaseTable` with its meaning; the key is required if the field has no default.
    `allowed`: the allowed values as text, if the type does not show them; `more`: further arguments
    of `pydantic.Field`.
    """
    return Field(default, title=meaning, **({"description": allowed} if allowed else {}), **more)


def subtable(meaning: str, name: str, default: Any = ...) -> Any:
    """A field for a table within a table."""
    return doc(meaning, default, f"the table [{name}]")


def hover(field: FieldInfo) -> str:
    """The text that an editor shows for a key: its meaning, and the values that it may have."""
    sentences = [field.title, f"allowed: {field.description}" if field.description else None]
    return " ".join(f"{text[0].upper()}{text[1:]}." for text in sentences if text)


class CaseTable(pydantic.BaseModel):
    """A strict TOML table: no unknown keys, no conversions, no NaN or infinite numbers.

    The title of a field is its meaning, and its description is the text of the allowed values in
    messages. Without a description, `allowed_text` makes this text from the type if it can.
    """

    # Built at the first use: of the tables of all kinds, a case has a few.
    model_config = pydantic.ConfigDict(
        defer_build=True,
        extra="forbid",
        strict=True,
        frozen=True,
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
    )

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        for key in cls.model_fields.values():
            key.description = key.description or allowed_text(key.annotation, key.metadata)
        return handler(source)

    @classmethod
    def __get_pydantic_json_schema__(cls, source: Any, handler: Any) -> dict[str, Any]:
        """The schema, with a text for an editor at every key; None and "" do not count as
        defaults."""
        reference = handler(source)
        table = handler.resolve_ref_schema(reference)
        del table["title"]
        for name, entry in cls.model_fields.items():
            key = table["properties"][entry.alias or name]
            key.pop("title", None)
            if text := hover(entry):
                key["description"] = text
            if key.get("default") in (None, ""):
                key.pop("default", None)
        return reference


# {name of a table: its format, or several of which a case has one}. "" is the whole file, "place[]"
# an array of tables, "units.*" a table of tables, "place[].demand" a table in each of an array.
Formats = Mapping[str, type[CaseTable] | Sequence[type[CaseTable]]]

TITLE = "a text of at most 200 characters in quotation marks"
Title = Annotated[str, Field(title="title of reports", max_length=200, description=TITLE)]
Nonempty = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Range(1)]
Positive = Annotated[float, Range(0, endpoints="()")]
NotNegative = Annotated[float, Range(0)]


AnyTable = TypeVar("AnyTable", bound=CaseTable)


def optional(*keys: str, note: str) -> Callable[[type[AnyTable]], type[AnyTable]]:
    """Decorates a table whose numbers at `keys` may be omitted and are then None; `note` is added
    to the text of their range."""

    def decorated(table: type[AnyTable]) -> type[AnyTable]:
        changes: dict[str, Any] = {"__doc__": table.__doc__, "__module__": table.__module__}
        for key in keys:
            field = table.model_fields[key]
            (numbers,) = field.metadata
            kind: Any = Annotated[field.annotation, numbers._replace(note=numbers.note + note)]
            changes[key] = (kind | None, Field(None, title=field.title))
        return pydantic.create_model(table.__name__, __base__=table, **changes)

    return decorated


def not_utf8(error: UnicodeDecodeError) -> str:
    """The message for a text file in another encoding, with the line and the byte."""
    raw = error.object
    line = raw.count(b"\n", 0, error.start) + 1
    return f"byte 0x{raw[error.start]:02x} on line {line} is not UTF-8; save the file as UTF-8"


class TableRead(NamedTuple):
    """A table of a case that was checked: its name in messages, its data, and its options.
    `options`: {key: the strings and booleans that it may have}, for keys with several such values.
    """

    name: str
    data: Any
    fields: Mapping[str, FieldInfo]
    options: Mapping[str, tuple[str | bool, ...]]


_tables_read: ContextVar[list[TableRead] | None] = ContextVar("tables read", default=None)


@contextmanager
def recorded_tables() -> Iterator[list[TableRead]]:
    """Collects every table that is checked within the context."""
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

    `notes`, `path`: the notes and the path of the `TableContext` that the readers of its keys
    receive.
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
    """Refuses numbers that would overflow, and texts that are too long, at every key."""
    for key in table.model_fields_set:
        where = f"{name}.{key}" if name else key
        message = f"it must be {type(table).model_fields[key].description}"
        for item in _plain(getattr(table, key)):
            if isinstance(item, str) and len(item) > LONGEST:
                message += f"; no text of a case has more than {LONGEST:,} characters"
                raise CaseError(file, where, item, message)
            if isinstance(item, int | float) and abs(item) > LARGEST:
                raise CaseError(file, where, float(item), f"{message}; {TOO_LARGE}")


def _plain(value: Any) -> Iterator[Any]:
    """A value, or all values in its lists."""
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
    return CaseError(file, where, value, f"it must be {allowed}")
