"""Declares the numbers of a case, each in one place.

A `Quantity` has the metadata of a number: unit, range, meaning, and the size of a standard move.
When it is called with a meaning, it makes a field of a `Table`. From this one line come the reader,
the messages, the documentation, the input with its sensitivity, and the position in the files where
a new value can be written:

    COST = Quantity("{currency}/{volume_unit}", group="cost", move=0.01, by="date")

    class ContractTable(Table):
        injection_cost: CaseInput = COST("per unit injected", 0.0)
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import date
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationInfo
from pydantic.fields import FieldInfo
from pydantic_core import core_schema

from .csv import FileReference, Row, ordinals, read_rows, rising_dates
from .error import CaseError
from .given import CaseInput
from .plausible import Plausible
from .table import LARGEST, TOO_LARGE, CaseTable, Range, TableContext, doc

ANY, NOT_NEGATIVE, POSITIVE = Range(), Range(0.0), Range(0.0, endpoints="()")
FRACTION, BELOW_ONE = Range(0.0, 1.0), Range(0.0, 1.0, "[)")


@dataclass(frozen=True)
class Quantity:
    """The declaration of a number.

    - `unit`: the name of a key in braces is replaced by the value of this key in the same table.
    - `range`: the allowed numbers; `limits`: the possible numbers, outside which a number is
      refused as a mistake; `plausible`: the usual numbers, outside which a note asks whether the
      unit is right.
    - `group`, `move`, `display_unit`, `display_factor`, `bump`, `meaning`: as in an `Input`.
    - `by`: the column of a CSV along which the number may change ("date"); `column`: the column
      with the numbers; `before`: the number that applies before the first row.
    - `text`: the allowed values as text, if the range does not describe them fully.
    - `name`: the name of the input, if it is not the key.
    """

    unit: str = "1"
    range: Range = ANY
    group: str = ""
    move: float | None = None
    display_unit: str = ""
    display_factor: float = 1.0
    limits: Range = ANY
    plausible: Plausible | None = None
    by: str = ""
    column: str = "value"
    before: float | None = None
    bump: float | None = None
    meaning: str = ""
    text: str = ""
    name: str = ""

    def __call__(self, meaning: str, default: Any = ..., **changes: Any) -> Any:
        """A field of a `Table` with this meaning, required if there is no default."""
        return declared(replace(self, meaning=meaning, **changes), default)

    @property
    def allowed(self) -> str:
        """The values that the key may have, as text."""
        file = f", or the name of a CSV file with columns {self.by},{self.column}"
        return self.text or f"{self.range}{file if self.by else ''}"

    @property
    def title(self) -> str:
        """The meaning with the unit, in which names of other keys represent their values."""
        return self.meaning + f", in {self.unit.format_map(_Values())}" * (self.unit != "1")

    def read(self, raw: Any, key: "KeyContext") -> CaseInput | None:
        """The number at a key, or the numbers of the CSV that the key names."""
        if raw is None:
            return None
        quantity = replace(self, unit=key.filled(self.unit))
        if isinstance(raw, str) and raw and self.by:
            rows = key.rows(raw, self.by, self.column)
            return quantity.from_dated_rows(self.name or key.name, rows)
        return quantity.input(
            self.name or key.name, [quantity.checked(raw, key)], positions=(key.path,)
        )

    def from_dated_rows(self, name: str, rows: Sequence[Row]) -> CaseInput:
        """The numbers of a CSV, each of which applies from its date on."""
        dates = rising_dates(rows, self.by)
        labels = [day.isoformat() for day in dates]
        return self.from_rows(name, rows, labels, starts=ordinals(dates))

    def from_rows(self, name: str, rows: Sequence[Row], labels: Sequence[str], **more) -> CaseInput:
        """The numbers of one column, each with its cell."""
        values = [self.cell(row) for row in rows]
        positions = tuple(row.position(self.column) for row in rows)
        return self.input(name, values, labels, positions=positions, **more)

    def input(
        self, name: str, values: Any, labels: Sequence[str] = ("",), **more: Any
    ) -> CaseInput:
        """Numbers with all their metadata."""
        values = np.asarray(values, np.float64)
        more.setdefault("index", np.array(0) if tuple(labels) == ("",) else np.arange(len(values)))
        about = {
            key: getattr(self, key) for key in ("bump", "move", "display_unit", "display_factor")
        }
        about |= {"group": self.group, "meaning": self.meaning}
        about |= {"low": self.range.low, "high": self.range.high, "quantity": self}
        return CaseInput(name, values, tuple(labels), self.unit, **(about | more))

    def cell(self, row: Row) -> float:
        """The number in the column of a row, which must be in the range."""
        allowed = "" if self.range == ANY else str(self.range)
        number = row.number(self.column, *self.range.closed, allowed)
        if not self.limits.contains(number):
            raise row.error(self.column, f"{OUTSIDE} {self.limits}")
        return number

    def checked(self, raw: Any, key: "KeyContext") -> float:
        """A number of the TOML file, which must be in the range."""
        if isinstance(raw, bool) or not isinstance(raw, int | float):
            raise key.error(raw, f"it must be {self.allowed}")
        if isinstance(raw, float) and not math.isfinite(raw):
            raise key.error(raw, f"it must be {self.allowed}, and finite")
        if not self.range.contains(raw):
            raise key.error(raw, f"it must be {self.allowed}")
        if abs(raw) > LARGEST:  # an integer may be larger than any float
            raise key.error(raw, f"it must be {self.allowed}; {TOO_LARGE}")
        if not self.limits.contains(raw):
            raise key.error(raw, f"{OUTSIDE} {self.limits}")
        return float(raw)

    def __get_pydantic_core_schema__(self, *_) -> core_schema.CoreSchema:
        return _validator(self.read)

    def __get_pydantic_json_schema__(self, *_) -> dict[str, Any]:
        file = {"type": "string", "description": f"a CSV file, {self.by},{self.column}"}
        number = self.range.json()
        return {"anyOf": [number, file]} if self.by else number


OUTSIDE = "no market has this value; it must be"


class KeyContext(NamedTuple):
    """A key while it is read: its table, its name, and the values of the keys before it."""

    table: TableContext
    name: str
    values: Mapping[str, Any]

    @property
    def path(self) -> tuple[str | int, ...]:
        return (*self.table.keys, self.name)

    def error(self, value: Any, allowed: str) -> CaseError:
        return self.table.error(self.name, value, allowed)

    def rows(self, file: str, *columns: str) -> list[Row]:
        """The rows of the CSV that the key names."""
        return read_rows(FileReference(self.table, self.name, file), columns)

    def filled(self, unit: str) -> str:
        """A unit in which the names of keys in braces are replaced by their values."""
        return unit.format_map(_Values(self.values))


class _Values(dict):
    def __missing__(self, key: str) -> str:
        return key  # it is wrong, and has a separate message


ReadKey = Callable[[Any, KeyContext], Any]


class Custom(NamedTuple):
    """The declaration of a field that a function reads; `types`: the types of its values, for a
    JSON schema."""

    read: ReadKey
    types: tuple[str, ...]

    def __get_pydantic_core_schema__(self, *_) -> core_schema.CoreSchema:
        return _validator(self.read)

    def __get_pydantic_json_schema__(self, *_) -> dict[str, Any]:
        return {"type": list(self.types)}


def custom(
    meaning: str,
    read: ReadKey,
    allowed: str,
    default: Any = ...,
    types: Sequence[str] = ("string",),
) -> Any:
    """A field of a `Table` that a function reads; `allowed`: the allowed values as text."""
    return declared(Custom(read, tuple(types)), default, meaning, allowed)


def declared(declaration: Any, default: Any, meaning: str = "", allowed: str = "") -> Any:
    """A field whose type is a declaration: a `Quantity`, or a `Custom` reader."""
    texts = meaning or declaration.title, allowed or declaration.allowed
    field = doc(texts[0], default, texts[1], validate_default=True)
    assert isinstance(field, FieldInfo)
    field.metadata.append(declaration)
    return field


def quantity_of(field: FieldInfo) -> Quantity | None:
    """The declaration of a field; None if it is not a quantity."""
    return next((item for item in field.metadata if isinstance(item, Quantity)), None)


def _validator(read: ReadKey) -> core_schema.CoreSchema:
    def validated(raw: Any, info: ValidationInfo) -> Any:
        if isinstance(raw, CaseInput):
            return raw
        table = info.context
        assert isinstance(table, TableContext)
        return read(raw, KeyContext(table, str(info.field_name), info.data))

    return core_schema.with_info_plain_validator_function(validated)


def on_dates(table: CaseTable, days: Sequence[date], notes: list[str]) -> dict[str, CaseInput]:
    """{key: numbers} of a table; numbers that may change with time are expanded to the rising dates
    `days`."""
    numbers = {key: value for key, value in table if isinstance(value, CaseInput)}
    return {key: x.on(days, notes) if x.quantity.by else x for key, x in numbers.items()}


def stacked(name: str, parts: Sequence[CaseInput]) -> CaseInput:
    """Several inputs of one quantity as one input with index [..., len(parts)]; labels begin with
    the number of the part, from 1."""
    starts = np.cumsum([0, *(len(part.values) for part in parts)])
    prefixes = [f"{i} " if len(parts) > 1 else "" for i in range(1, len(parts) + 1)]
    return replace(
        parts[0],
        name=name,
        values=np.concatenate([part.values for part in parts]),
        labels=tuple(f"{p}{y}".strip() for p, x in zip(prefixes, parts) for y in x.labels),
        index=np.stack([x.index + start for x, start in zip(parts, starts)], axis=-1),
        positions=tuple(position for part in parts for position in part.positions),
        starts=None,
    )


def numbers_in(record: Any) -> Iterator[CaseInput]:
    """All numbers in a record, including the records and tuples within it, but no empty inputs."""
    if isinstance(record, CaseInput):
        if record.values.size:
            yield record
    elif isinstance(record, tuple):
        for item in record:
            yield from numbers_in(item)
    elif isinstance(record, BaseModel):
        yield from numbers_in(tuple(value for _, value in record))
    elif is_dataclass(record):
        yield from numbers_in(tuple(getattr(record, field.name, None) for field in fields(record)))


def by_name(numbers: Iterable[CaseInput]) -> dict[str, CaseInput]:
    """{name: numbers} of a case; two inputs with the same name are a fault of the reader."""
    named: dict[str, CaseInput] = {}
    for entry in numbers:
        if named.setdefault(entry.name, entry) is not entry:
            raise ValueError(f"{entry.name}: two inputs of a case share this name.")
    return named
