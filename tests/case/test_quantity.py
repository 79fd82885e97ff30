"""A number declared once: its range in words and in numbers, its reading, its positions."""

import datetime
import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from snapo.case.error import CaseError
from snapo.case.given import CaseInput, SheetCell
from snapo.case.quantity import (
    ANY,
    BELOW_ONE,
    NOT_NEGATIVE,
    POSITIVE,
    Quantity,
    Range,
    numbers_in,
    on_dates,
    quantity_of,
    stacked,
)
from snapo.case.table import CaseTable, NotNegative, optional, parse

ENDS = ("[]", "[)", "(]", "()")
NUMBERS = st.floats(-1e6, 1e6)
COST = Quantity("{money}/{volume}", group="cost", move=0.01, by="date", before=0.0)
SHARE = Quantity("1", BELOW_ONE, limits=Range(0.0, 0.9))


class Example(CaseTable):
    """A table with a number of each kind."""

    volume: str = "MWh"
    money: str = "EUR"
    cost: CaseInput = COST("per unit", 0.0)
    share: CaseInput = SHARE("of the volume")
    cap: CaseInput | None = Quantity("{volume}", POSITIVE)("the largest volume", None)
    rule: Literal["linear", "step"] = "linear"


def read(data, folder=Path(), notes=None):
    return parse(Example, data, str(folder / "case.toml"), "table", notes)


@given(st.tuples(NUMBERS, NUMBERS).map(sorted), st.sampled_from(ENDS), NUMBERS)
def test_a_range_holds_its_closed_interval_and_no_more(ends, kind, number):
    low, high = ends
    interval = Range(low, high, kind)
    first, last = interval.closed
    assert interval.contains(number) == (first <= number <= last)
    assert interval.contains(low) == (kind == "[]" or (kind == "[)" and low < high))
    assert not interval.contains(math.nan)
    if first <= last:
        assert interval.contains(first) and interval.contains(last)


@given(st.integers(-999, 999), st.integers(1, 999), st.sampled_from(ENDS))
def test_the_words_of_a_range_name_both_ends_and_differ_by_kind(low, width, kind):
    words = str(Range(low, low + width, kind, note=" a day"))
    assert f"{low:,}" in words and f"{low + width:,}" in words and words.endswith(" a day")
    assert len({str(Range(low, low + width, other)) for other in ENDS}) == len(ENDS)


@pytest.mark.parametrize(
    ("interval", "words", "keys"),
    [
        (ANY, "a number", {}),
        (NOT_NEGATIVE, "a number of at least 0", {"minimum": 0.0}),
        (POSITIVE, "a number above 0", {"exclusiveMinimum": 0.0}),
        (BELOW_ONE, "a number of at least 0 and below 1", {"minimum": 0.0, "exclusiveMaximum": 1.0}),
        (Range(high=5.0), "a number of at most 5", {"maximum": 5.0}),
        (Range(high=5.0, endpoints="[)"), "a number below 5", {"exclusiveMaximum": 5.0}),
        (Range(0.0, 9.0, noun="jumps a year"), "jumps a year from 0 to 9",
         {"minimum": 0.0, "maximum": 9.0}),
    ],
)  # fmt: skip
def test_a_range_in_words_and_as_a_schema(interval, words, keys):
    assert str(interval) == words
    assert interval.json() == {"type": "number", **keys}


@given(st.floats(0.0, 0.9, allow_subnormal=False))
def test_a_number_keeps_its_bits_and_gets_all_of_its_declaration(number):
    table = read({"share": number, "money": "USD"})
    assert table.share.values.tolist() == [number] and table.share.used() == number
    assert table.share.positions == (("table", "share"),) and table.share.written == number
    assert (table.cost.unit, table.cost.meaning, table.cost.move) == ("USD/MWh", "per unit", 0.01)
    assert table.cap is None
    assert [x.name for x in numbers_in((table,))] == ["cost", "share"]


@given(st.one_of(st.floats(), st.integers(), st.booleans(), st.text(max_size=5)))
def test_anything_else_is_refused_in_the_words_of_the_range(value):
    inside = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 0.9
    if inside:
        assert read({"share": value}).share.values == [value]
        return
    with pytest.raises(CaseError) as refused:
        read({"share": value})
    error = refused.value
    assert error.where == "table.share" and "a number of at least 0 and below 1" in error.allowed


def test_every_mistake_of_a_table_is_named_at_once():
    with pytest.raises(CaseError) as refused:
        read({"share": 1.0, "cap": 0, "cost": "", "rule": 1, "shares": 2})
    errors = [refused.value, *refused.value.others]
    keys = {"table.share", "table.cap", "table.cost", "table.rule", "table.shares"}
    assert {error.where for error in errors} == keys
    assert "no such key" in str(refused.value) and "the name of a CSV file" in str(refused.value)


def test_limits_are_refused_with_their_own_reason():
    with pytest.raises(CaseError, match=r"0\.95; no market has this value; it must be .* to 0\.9"):
        read({"share": 0.95})


def test_a_csv_gives_a_number_for_each_date_and_its_cell(tmp_path):
    (tmp_path / "cost.csv").write_text("# of 2024\ndate,value\n2024-01-03,1.5\n2024-01-05,2.5\n")
    notes = []
    table = read({"share": 0, "cost": "cost.csv"}, tmp_path, notes)
    assert table.cost.positions == (
        SheetCell("cost.csv", 3, "value"),
        SheetCell("cost.csv", 4, "value"),
    )
    assert table.cost.written == "cost.csv"
    days = [datetime.date(2024, 1, n) for n in range(1, 7)]
    daily = on_dates(table, days, notes)["cost"]
    assert daily.used().tolist() == [0.0, 0.0, 1.5, 1.5, 2.5, 2.5]
    assert daily.labels == ("before 2024-01-03", "2024-01-03", "2024-01-05")
    assert daily.positions[0] is None and len(daily.positions) == 3
    assert notes == ["cost.csv begins on 2024-01-03; until then cost is 0."]
    assert on_dates(table, days[2:], [])["cost"].used().tolist() == [1.5, 1.5, 2.5, 2.5]


def test_numbers_that_begin_too_late_are_refused_where_nothing_holds_before(tmp_path):
    (tmp_path / "level.csv").write_text("date,value\n2024-01-03,1.5\n")

    class Dated(CaseTable):
        level: CaseInput = Quantity("MWh", by="date")("a level")

    table = parse(Dated, {"level": "level.csv"}, str(tmp_path / "case.toml"), "table")
    with pytest.raises(CaseError, match=r"level\.csv, line 2, column date: .*2024-01-01 on"):
        on_dates(table, [datetime.date(2024, 1, 1)], [])


@given(st.lists(st.lists(st.floats(0, 1), min_size=1, max_size=3), min_size=1, max_size=3))
def test_several_numbers_are_one_with_an_index_into_all(parts):
    quantity = Quantity("1", meaning="a factor")
    several = [
        quantity.input("x", values, [f"{i}" for i in range(len(values))]) for values in parts
    ]
    firsts = [x.values[0] for x in several]
    heads = [replace_index(x) for x in several]
    together = stacked("xs", heads)
    assert together.used().tolist() == firsts
    assert together.values.tolist() == [number for values in parts for number in values]
    assert len(set(together.labels)) == len(together.labels)


def replace_index(numbers: CaseInput) -> CaseInput:
    import dataclasses

    return dataclasses.replace(numbers, index=np.array(0))


def test_a_table_of_declarations_has_a_schema_and_a_documentation():
    schema = Example.model_json_schema()["properties"]
    assert schema["share"] | {"type": "number", "minimum": 0.0} == schema["share"]
    assert schema["share"]["description"] == (
        "Of the volume. Allowed: a number of at least 0 and below 1."
    )
    assert schema["cost"]["description"].startswith("Per unit, in money/volume. Allowed: a number")
    fields = Example.model_fields
    assert quantity_of(fields["cost"]) is not None and quantity_of(fields["rule"]) is None
    assert fields["cost"].description == (
        "a number, or the name of a CSV file with columns date,value"
    )
    assert fields["cost"].default == 0.0 and fields["share"].is_required()


SHARE_KEPT = Range(0.0, 1.0, "(]")


class Settings(CaseTable):
    """Keys that their types describe."""

    kind: Literal["one", "two", "three"] = "one"
    paths: Annotated[int, Range(2, 10_000, note=": more do not fit")] = 2
    starts: Annotated[int, Range(1, noun="a number of weights")] = 1
    keep: Annotated[float, SHARE_KEPT] | Literal["auto"] = "auto"
    rate: Annotated[float, POSITIVE] | None = None
    level: Annotated[float, BELOW_ONE] = Field(0.0, description="a level")
    values: NotNegative | Annotated[str, Field(description="a CSV file")] = 0.0
    name: str = ""


DESCRIPTIONS = {
    "kind": '"one", "two" or "three"',
    "paths": "a whole number, 2 to 10,000: more do not fit",
    "starts": "a number of weights, 1 or more",
    "keep": 'a number above 0, at most 1, or "auto"',
    "rate": "a number above 0",
    "level": "a level",
    "values": "a number of at least 0, or a CSV file",
}
LEFT_OUT = ", or left out: 5"


@optional("paths", "level", note=LEFT_OUT)
class Chosen(Settings):
    """Settings of which some are chosen."""


def test_a_key_is_described_by_its_type():
    fields, schema = Settings.model_fields, Settings.model_json_schema()["properties"]
    for key, text in DESCRIPTIONS.items():
        assert fields[key].description == text
        assert schema[key]["description"] == f"Allowed: {text}."
    assert fields["name"].description is None and "description" not in schema["name"]
    assert (schema["paths"]["minimum"], schema["paths"]["maximum"]) == (2, 10_000)
    assert schema["keep"]["anyOf"][0] == {"type": "number", "exclusiveMinimum": 0.0, "maximum": 1.0}
    with pytest.raises(CaseError, match=r"keep: got 0.*must be a number above 0, at most 1, or"):
        parse(Settings, {"keep": 0.0}, "case.toml", "settings")


@given(st.sampled_from(["paths", "starts", "keep", "level"]), st.integers(-3, 3))
def test_a_type_takes_the_numbers_of_its_range_and_no_others(key, number):
    ranges = {"paths": Range(2, 10_000), "starts": Range(1), "keep": SHARE_KEPT, "level": BELOW_ONE}
    data = {key: number}
    if ranges[key].contains(number):
        assert getattr(parse(Settings, data, "case.toml", "settings"), key) == number
        return
    with pytest.raises(CaseError) as refused:
        parse(Settings, data, "case.toml", "settings")
    assert refused.value.allowed == f"it must be {DESCRIPTIONS[key]}"


def test_numbers_that_may_be_left_out_keep_their_range():
    assert Chosen.__name__ == "Chosen" and Chosen.__doc__ == "Settings of which some are chosen."
    assert issubclass(Chosen, Settings) and Chosen.__module__ == __name__
    table = Chosen()
    assert (table.paths, table.level, table.starts) == (None, None, 1)
    assert Chosen(paths=7).paths == 7 and Settings().paths == 2
    fields = Chosen.model_fields
    assert fields["paths"].description == DESCRIPTIONS["paths"] + LEFT_OUT
    assert fields["level"].description == "a number of at least 0 and below 1" + LEFT_OUT
    assert fields["starts"].description == DESCRIPTIONS["starts"]
    with pytest.raises(CaseError, match="2 to 10,000: more do not fit, or left out: 5"):
        parse(Chosen, {"paths": 1}, "case.toml", "settings")
