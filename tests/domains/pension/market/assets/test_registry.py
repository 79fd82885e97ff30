"""Kinds of asset classes: all files are found, and an incomplete kind is an error at import."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

from snapo.domains.pension.market.assets.asset_class import register
from snapo.domains.pension.market.assets.cash import Cash
from snapo.domains.pension.market.assets.priced import Priced
from snapo.domains.pension.market.registry import KINDS

DOCS = Path(__file__).parents[5] / "docs" / "pension_case.md"


def test_every_kind_is_found_and_described():
    assert set(KINDS) == {
        *("cash", "bond", "coupon-bond", "index-linked", "credit"),
        *("equity", "property", "commodity", "hedge-fund"),
    }
    text = DOCS.read_text()
    for name, kind in KINDS.items():
        assert kind.description
        assert f"| {name} |" in text, f"{name} has no row in {DOCS.name}"


def test_an_incomplete_kind_is_an_error():
    @dataclass(frozen=True)
    class Unpriced(Cash):
        kind: ClassVar[str] = "unpriced"
        columns: ClassVar[tuple[str, ...]] = ("colour",)
        risk: ClassVar[str] = "none"

    with pytest.raises(TypeError, match="no columns colour"):
        register(Unpriced)

    with pytest.raises(TypeError, match="the kind 'cash' is already registered by Cash"):
        register(type("Again", (Cash,), {"risk": "none"}))


def test_a_kind_says_what_its_regulator_sees_in_it():
    """Shares of a new kind without a word on it were charged nothing; what follows the curve says
    by which payments."""
    tokens = {"kind": "token", "description": "tokens"}
    with pytest.raises(TypeError, match="Token: a kind of asset class needs risk"):
        register(type("Token", (Priced,), tokens))
    with pytest.raises(
        TypeError, match="Token: there is no risk 'unheard'; the risks are developed, emerging"
    ):
        register(type("Token", (Priced,), tokens | {"risk": "unheard"}))
    assert "token" not in KINDS
    assert {name: kind.risk for name, kind in KINDS.items() if kind.risk != "none"} == {
        "equity": "developed",
        "property": "unlisted-property",
        "commodity": "commodity",
        "hedge-fund": "unlisted",
    }
    assert all(kind.own_shock == (kind.risk != "none") for kind in KINDS.values())


def test_a_kind_without_returns_is_an_error():
    from snapo.domains.pension.market.assets.bond import Maturing

    with pytest.raises(TypeError, match=r"needs kind, description, columns.*risk.*log_return"):
        register(type("Half", (Maturing,), {}))
