"""The JSON schema of a kind: every template is valid by it, and a mistake in a key is not."""

import json
import tomllib
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import pytest

from snapo.case.error import CaseError
from snapo.cli.completion import OTHER_FILES, schema_of_kind
from snapo.cli.main import main
from snapo.study import commands
from snapo.study.domain import find, installed

TEMPLATES = [(kind, size) for kind in installed() for size in find(kind, "").templates]
TYPES = {
    "object": dict, "array": list, "string": str, "integer": int, "boolean": bool,
    "number": (int, float), "null": type(None),
}  # fmt: skip


def mistakes(
    value: Any, schema: Mapping[str, Any], root: Mapping[str, Any], at=""
) -> Iterator[str]:
    """What a validator would say, of the keywords that the schemas use."""
    if "$ref" in schema:
        parts = schema["$ref"].removeprefix("#/").split("/")
        inner = root
        for part in parts:
            inner = inner[part]
        yield from mistakes(value, inner, root, at)
    if "anyOf" in schema:
        several = [list(mistakes(value, x, root, at)) for x in schema["anyOf"]]
        if all(several):
            yield min(several, key=len)[0]
    if "const" in schema and value != schema["const"]:
        yield f"{at}: not {schema['const']}"
    if "enum" in schema and value not in schema["enum"]:
        yield f"{at}: not one of {schema['enum']}"
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds and not any(of_type(value, kind) for kind in kinds):
        yield f"{at}: not {kinds}"
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = schema.get("minimum", value), schema.get("maximum", value)
        above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
        inside = low <= value <= high
        if (
            not inside
            or (above is not None and value <= above)
            or (below is not None and value >= below)
        ):
            yield f"{at}: out of range"
    if isinstance(value, dict):
        known = schema.get("properties", {})
        yield from (
            f"{at}.{key}: missing" for key in schema.get("required", []) if key not in value
        )
        for key, item in value.items():
            other = schema.get("additionalProperties", True)
            if key in known:
                yield from mistakes(item, known[key], root, f"{at}.{key}")
            elif other is False:
                yield f"{at}.{key}: unknown"
            elif isinstance(other, dict):
                yield from mistakes(item, other, root, f"{at}.{key}")
    if isinstance(value, list) and "items" in schema:
        for i, item in enumerate(value):
            yield from mistakes(item, schema["items"], root, f"{at}[{i}]")


def of_type(value: Any, kind: str) -> bool:
    if isinstance(value, bool) and kind != "boolean":
        return False
    if kind == "string":
        return isinstance(value, str) or hasattr(value, "isoformat")
    return isinstance(value, TYPES[kind])


def written(kind, size, folder):
    commands.new(kind, folder, size)
    return tomllib.loads((folder / "case.toml").read_text())


@pytest.mark.parametrize(("kind", "size"), TEMPLATES)
def test_a_template_is_valid_by_the_schema_of_its_kind(kind, size, tmp_path):
    schema = schema_of_kind(kind)
    assert list(mistakes(written(kind, size, tmp_path), schema, schema)) == []


def test_mistakes_in_a_storage_case_are_found(tmp_path):
    case, schema = written("gas-storage", None, tmp_path), schema_of_kind("gas-storage")
    case["contract"] |= {"inventori": 1, "injection_fuel": 1.0, "ratchet_interpolation": "cubic"}
    del case["market"]["valuation_date"]
    messages = sorted(mistakes(case, schema, schema))
    assert [message.partition(":")[0] for message in messages] == [
        ".contract.injection_fuel", ".contract.inventori", ".contract.ratchet_interpolation",
        ".market.valuation_date",
    ]  # fmt: skip


FILES = [*installed(), *OTHER_FILES]
HOVERS = {  # {kind: table, key, text}
    "gas-storage": ("ContractTable", "injection_cost",
        "Cost per unit injected, in currency/volume_unit. Allowed: a number, or the name of a CSV "
        "file with columns date,value."),
    "swing": ("AnnualTable", "max",
        "Maximum volume of a contract year, in volume_unit/year. Allowed: a number of at least 0."),
    "battery": ("FadeTable", "every",
        "Energy that is taken before the store can hold less, in MWh. Allowed: a number above 0: "
        "MWh taken."),
    "park-and-loan": ("WindowTable", "last",
        "Last day on which gas may flow. Allowed: a date from 1900 to 2200, YYYY-MM-DD."),
    "stores": ("StoresTable", "net_injection",
        "Largest joint flow into the stores, in volume_unit/day. Allowed: a number of at least 0, "
        "or the name of a CSV file with columns date,value."),
    "plant": ("PowerPlantTable", "min_up",
        "Smallest number of hours that the plant stays on after a start. Allowed: a whole number "
        "of hours, 1 to 72."),
    "pension": ("IndexationTable", "lower_ratio",
        "Funding ratio below which there is no indexation. Allowed: a number of at least 0."),
    "pharma": ("WetMillTable", "speed",
        'Tip speed of the rotor. Allowed: a quantity in quotation marks of at least 0, such as '
        '"20 m/s", or { nodes = ["20 m/s", "20 m/s"] }.'),
    "inventory": ("ItemTable", "unmet",
        'Whether unmet demand is lost or waits. Allowed: "lost" or "waits".'),
    "control": ("NormalStart", "deviation",
        "Standard deviation of the initial state. Allowed: a number above 0, or a list of them."),
    "own": ("FollowingTable", "temperature_end",
        "Temperature of the smoothed rules in the last quarter of the steps. Allowed: a number "
        "above 0."),
    "book": ("TasksTable", "judge",
        "Share of the contracts whose derivatives are tested by bumps. Allowed: a number from 0 to 1."),
    "calibration": ("HistoryTable", "season",
        "Number of waves of the seasonal pattern in a year. Allowed: 0, 1 or 2."),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_an_editor_shows_the_meaning_of_a_key_with_its_values(kind):
    table, key, text = HOVERS[kind]
    assert schema_of_kind(kind)["$defs"][table]["properties"][key]["description"] == text


@pytest.mark.parametrize("kind", FILES)
def test_every_key_has_a_meaning_and_only_defaults_that_a_case_could_have(kind):
    schema = schema_of_kind(kind)
    for name, table in schema["$defs"].items():
        assert "title" not in table
        for key, item in table["properties"].items():
            meaning, _, allowed = item["description"].partition(". Allowed: ")
            assert len(meaning) > 3 and not meaning.startswith("Allowed"), (name, key)
            assert meaning.lower() != allowed.removesuffix(".").lower(), (name, key)
            assert "title" not in item
            if "default" in item:
                assert list(mistakes(item["default"], item, schema)) == [], (name, key)


def tables_of(kind):
    """Every table of a kind of file."""
    formats: Any = import_module(OTHER_FILES[kind]).FORMATS if kind in OTHER_FILES else None
    for tables in (formats or find(kind, "").formats()).values():  # pyright: ignore
        yield from [tables] if isinstance(tables, type) else tables


@pytest.mark.parametrize("kind", FILES)
def test_every_table_that_a_schema_names_is_a_part_of_the_file(kind):
    """A name that no parent has would be left out without a word."""
    schema = schema_of_kind(kind)
    text = json.dumps({key: x for key, x in schema.items() if key != "$defs"})
    text += json.dumps([x.get("properties", {}) for x in schema["$defs"].values()])
    for table in tables_of(kind):
        assert table.__name__ in text


def test_the_command_prints_it(capsys):
    assert main(["schema", "own"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "A case of kind own"
    assert main(["schema", "owl"]) == 2
    assert "the nearest known kind is own" in capsys.readouterr().err


def test_a_domain_without_tables_says_so(monkeypatch):
    from snapo.study import domain

    monkeypatch.setattr(domain, "find", lambda *_: object())
    with pytest.raises(CaseError, match="does not list its tables"):
        schema_of_kind("plugin")


def test_a_key_may_be_a_number_or_a_table(tmp_path):
    case, schema = written("swing", None, tmp_path), schema_of_kind("swing")
    for strike in (29.0, "strikes.csv", {"index": "month-ahead", "add": 0.25}):
        case["contract"]["strike"] = strike
        assert list(mistakes(case, schema, schema)) == []
    case["contract"]["strike"] = {"index": "month-ahead", "sum": 0.25}
    assert list(mistakes(case, schema, schema)) != []
