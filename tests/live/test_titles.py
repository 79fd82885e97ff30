"""A choice is named for people by what it belongs to."""

import pytest

from snapo.live.moves import title

TABLES = {
    "kind": "pharma",
    "plan": {"timing": "arrears", "indexation": {"kind": "capped"}},
    "units": {"mill": {"kind": "wet", "size_law": {"scale": "K", "kind": "a"}}},
    "parameters": [
        {"name": "Granule size", "distribution": {"kind": "normal"}},
        {"name": "", "distribution": {"kind": "normal"}},
    ],
    "batches": [{"title": "First", "name": "b1", "steps": [{"mode": "on"}]}],
}


@pytest.mark.parametrize(
    ("key", "words"),
    [
        (("parameters", 0, "distribution", "kind"), "Granule size: distribution"),
        (("parameters", 1, "distribution", "kind"), "Parameter 2: distribution"),
        (("units", "mill", "kind"), "Mill: kind"),
        (("units", "mill", "size_law", "scale"), "Mill: size law, scale"),
        (("units", "mill", "size_law", "kind"), "Mill: size law"),
        (("plan", "timing"), "Plan: timing"),
        (("plan", "indexation", "kind"), "Plan: indexation"),
        (("batches", 0, "unmet"), "First: unmet"),
        (("batches", 0, "steps", 0, "mode"), "Step 1: mode"),
        (("numerics", "method"), "Numerics: method"),  # a table that the case leaves out
        (("fund_step",), "Fund step"),
    ],
)
def test_a_key_in_words(key, words):
    assert title(TABLES, key) == words
