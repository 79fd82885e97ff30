"""A number of a unit, declared once as a field of its record.

    SPEED = UnitQuantity("m/s", NOT_NEGATIVE, example="20 m/s")

    @dataclass(frozen=True, eq=False)
    class WetMill(Timed):
        speed: Profile = SPEED.profile("tip speed of the rotor")
        reference_speed: CaseInput = SPEED("speed to which the rate refers")

Such a line yields the key of the table, its range and the message of a mistake, the documentation,
the conversion of units, the input of the sensitivities, and its position in the file.
"""

import dataclasses
from dataclasses import MISSING, dataclass, replace
from functools import cache
from typing import Any, ClassVar, Literal, Self

import pydantic
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from snapo.case.quantity import KeyContext, Quantity, Range, custom, declared, quantity_of
from snapo.case.table import CaseTable, TableContext, doc, parse

from .numbers import (
    ANY,
    DENSITY,
    NOT_NEGATIVE,
    POSITIVE,
    PURE,
    TEMPERATURE,
    profile,
    quantity,
    range_text,
    single,
)
from .reader import Reader, TextKey


@dataclass(frozen=True)
class UnitQuantity(Quantity):
    """A number with its unit, such as "30 min"; a call with a meaning makes a field of a record.

    - `example`: a value as text. `alias`: the key, if it differs from the name of the field.
    - `form` of the field: an input, a profile over time, or a constant number.
    """

    range: Range = ANY
    example: str = ""
    alias: str = ""
    form: Literal["input", "profile", "number"] = "input"

    def __call__(self, meaning: str, default: Any = ..., **changes: Any) -> Any:
        """A field of a record with this meaning, required if there is no default."""
        changed = replace(self, meaning=meaning, **changes)
        return key(declared(changed, default), changed.alias)

    def field(self, meaning: str, default: Any = ..., **changes: Any) -> Any:
        """A field of a `CaseTable` with this meaning."""
        return declared(replace(self, meaning=meaning, **changes), default)

    def profile(self, meaning: str, default: Any = ..., **changes: Any) -> Any:
        """A field for a control over the time of a unit."""
        return self(meaning, default, form="profile", **changes)

    def number(self, meaning: str, default: Any = ..., **changes: Any) -> Any:
        """A field for a number that is not an input."""
        return self(meaning, default, form="number", **changes)

    @property
    def title(self) -> str:
        return self.meaning  # a case writes the unit with the number

    @property
    def allowed(self) -> str:
        text = range_text(self.range, self.unit)
        if self.unit not in PURE:
            text = text.replace("a quantity", "a quantity in quotation marks", 1)
        text += f', such as "{self.example}"' if self.example else ""
        nodes = f', or {{ nodes = ["{self.example}", "{self.example}"] }}'
        return text + (nodes if self.form == "profile" else "")

    def read(self, raw: Any, key: KeyContext) -> Any:
        """The value of the field; None if the key has no value."""
        if raw is None:
            return None
        table, bounds = key.table, self.range
        if self.form == "number":
            return quantity(table, key.name, raw, self.unit, bounds)
        name = f"{number_name(table)}.{key.name}"
        read = profile if self.form == "profile" else single
        return read(table, name, key.name, raw, self.unit, bounds, self.meaning)

    def __get_pydantic_json_schema__(self, *_) -> dict[str, Any]:
        text: dict[str, Any] = {"type": "string"}
        kinds = [self.range.json(), text] if self.unit in PURE else [text]
        kinds += [{"type": "object"}] if self.form == "profile" else []
        return {"anyOf": kinds} if len(kinds) > 1 else kinds[0]


TIME = UnitQuantity("s", POSITIVE, example="3600 s")
RATE = UnitQuantity("1/s", NOT_NEGATIVE, example="1e-3 1/s")
LENGTH = UnitQuantity("m", POSITIVE, example="20 um")
ABSOLUTE = UnitQuantity("K", TEMPERATURE, example="313.15 K")
PRESSURE = UnitQuantity("Pa", NOT_NEGATIVE, example="1 bar")
CONCENTRATION = UnitQuantity("kg/m3", POSITIVE, example="20 kg/m^3")
VOLUME = UnitQuantity("m3", POSITIVE, example="10 L")
FLOW = UnitQuantity("m3/s", NOT_NEGATIVE, example="5 mL/min")
AREA = UnitQuantity("m2", POSITIVE, example="0.5 m^2")
SPEED = UnitQuantity("m/s", NOT_NEGATIVE, example="20 m/s")
DIFFUSIVITY = UnitQuantity("m2/s", POSITIVE, example="7e-10 m^2/s")
ENERGY = UnitQuantity("J/mol", example="40 kJ/mol")
MOLAR_MASS = UnitQuantity("kg/kmol", POSITIVE, example="150 g/mol")
CRYSTALS = UnitQuantity("kg/m3", DENSITY, example="1200 kg/m^3")
POWER, SHAPE = UnitQuantity(range=NOT_NEGATIVE), UnitQuantity(range=POSITIVE, example="0.5236")


def number_name(table: TableContext) -> str:
    """The prefix of the numbers of a table: "reactor.jacket" of [units.reactor.jacket]."""
    return table.name.partition(".")[2]


def key(field: Any, name: str = "", **more: Any) -> Any:
    """A field of a record that is read from a key of its table; `name`: the key, if it differs from
    the field."""
    assert isinstance(field, FieldInfo)
    default = field.default
    if default is PydanticUndefined or (quantity_of(field) and default is not None):
        default = MISSING
    metadata = {"key": field, "name": name} | more
    return dataclasses.field(default=default, metadata=metadata, kw_only=default is not MISSING)


def species_key(meaning: str, allowed: str) -> Any:
    """A field for one of the case's species: its name, or its number if the field is an int."""
    return key(doc(meaning, allowed=allowed), type=TextKey, species=True)


def inner(meaning: str, record: type["TableRecord"], default: Any = ..., name: str = "") -> Any:
    """A field for the record of an inner table."""

    def read(raw: Any, key: KeyContext) -> Any:
        if raw is None:
            return None
        table = key.table
        section = TableContext(table.file, f"{table.name}.{key.name}", table.notes)
        data = parse(record.table, raw, str(table.file), section.name, table.notes)
        return record.read(Reader(section, number_name(section), data, raw))

    words = f"the table {record.heading.strip('`[]').rpartition('.')[2]}"
    return key(custom(meaning, read, words, default, ("object",)), name)


class TableOf:
    """The table of a record, from the declarations of its fields and its `more_keys`."""

    def __get__(self, _: Any, record: Any) -> type[CaseTable]:
        return _table(record)


@cache
def _table(record: Any) -> type[CaseTable]:
    return pydantic.create_model(
        f"{record.__name__}Table",
        __base__=CaseTable,
        __doc__=record.heading,
        __module__=record.__module__,
        **(record.more_keys | keys_of(record)),
    )


def keys_of(record: Any) -> dict[str, Any]:
    """{key: (type, declaration)} of the declared fields of a record."""
    return {
        field.metadata["name"] or field.name: (
            field.metadata.get("type", field.type),
            field.metadata["key"],
        )
        for field in _declared_fields(record)
    }


def _declared_fields(record: Any) -> list[dataclasses.Field]:
    return [field for field in dataclasses.fields(record) if "key" in field.metadata]


def values(record: type, read: Reader, species: tuple[str, ...] = ()) -> dict[str, Any]:
    """{field: value} of the declared fields of a record, from its table."""
    result = {}
    for field in _declared_fields(record):
        name = field.metadata["name"] or field.name
        if "species" in field.metadata:
            one = read.one_of(name, species, "species")
            result[field.name] = species.index(one) if field.type is int else one
        else:
            result[field.name] = getattr(read.table, name)
    return result


class TableRecord:
    """An inner table of a unit, its fields declared; `heading`: the name of the table.

    - `more_keys`: {key: (type, declaration)} of keys that are not fields.
    """

    heading: ClassVar[str]
    more_keys: ClassVar[dict[str, Any]] = {}
    table = TableOf()

    @classmethod
    def read(cls, read: Reader) -> Self:
        """The record from its table; mistakes are `CaseError`s."""
        return cls(**values(cls, read))
