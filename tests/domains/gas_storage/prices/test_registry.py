"""A price process is whole or it is refused, and the case file knows each by its kind."""

import pytest

from snapo.domains.gas_storage.prices.factors import OneFactor
from snapo.domains.gas_storage.prices.process import KINDS, PriceProcess, missing_members, register
from snapo.domains.gas_storage.prices.registry import kinds

PARTS = {"step", "level", "forward", "initial", "prepare", "observe", "describe", "state_at"}


def test_every_kind_is_whole_and_says_its_table():
    found = kinds()
    assert {"one-factor", "multi-factor", "three-factor-seasonal", "regimes", "supplied"} <= set(
        found
    )
    for kind, process in found.items():
        assert missing_members(process) == []
        assert process.table.model_fields["kind"].annotation.__args__ == (kind,)


def test_a_process_without_dynamics_is_refused():
    """The class that once was valued silently without noise cannot be registered, nor made."""

    class Dull(PriceProcess):
        kind = "dull"

    assert set(missing_members(Dull)) >= PARTS
    with pytest.raises(TypeError, match=r"price process Dull has no .*forward.*noise_size.*step"):
        register(Dull)
    with pytest.raises(TypeError):
        Dull()
    assert "dull" not in KINDS


@pytest.mark.parametrize("part", ["step", "state_at"])
def test_one_missing_method_is_named(part):
    """Everything of a one-factor price is there but for one method, which is abstract again."""
    abstract = getattr(PriceProcess, part)
    Almost = type(OneFactor)("Almost", (OneFactor,), {part: abstract, "kind": "almost"})
    assert missing_members(Almost) == [part]
    with pytest.raises(TypeError, match=f"Almost has no {part}"):
        register(Almost)


def test_a_kind_is_taken_once():
    with pytest.raises(TypeError, match="'one-factor' is registered already"):
        register(OneFactor)
