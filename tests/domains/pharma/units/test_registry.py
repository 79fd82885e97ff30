"""The list of unit operations: complete, each documented, an incomplete one an error at once."""

import re
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE, template

import snapo
from snapo.domains.pharma.flowsheet.inputs import pharma_inputs
from snapo.domains.pharma.units.operation import Instant
from snapo.domains.pharma.units.registry import OPERATIONS, TYPES, catalogue
from snapo.domains.pharma.units.tank import Tank

DOCUMENT = Path(snapo.__file__).parents[2] / "docs" / "pharma_case.md"


def test_an_incomplete_operation_is_an_error_at_import():
    @dataclass(frozen=True, eq=False)
    class Half(Instant):
        type = "half"

    with pytest.raises(TypeError, match=r"Half has no deliver, equations, inlets.*variant, title"):
        catalogue([*OPERATIONS, Half])
    with pytest.raises(TypeError, match='Two unit operations are of type "tank"'):
        catalogue([*OPERATIONS, Tank])


@pytest.mark.parametrize("kind", TYPES)
def test_every_operation_is_documented(kind):
    """A row for its type, and every key of its tables."""
    text = DOCUMENT.read_text(encoding="utf-8")
    row = next(line for line in text.splitlines() if line.startswith(f'| "{kind}" |'))
    assert row.count("|") == 5
    for each in TYPES[kind].values():
        for key in each.table.model_fields:
            known = rf"`{key}`|`{key} = |\[units\.NAME\.{key}\]"
            assert re.search(known, text), f"{kind}: {key} is not documented"


def test_numbers_say_what_they_are():
    found = pharma_inputs(template())
    assert all(each.meaning and each.group for each in found.values())
    growth, warm = found["crystalliser.kinetics.growth"], found["reactor.temperature"]
    assert (growth.display_unit, growth.display_factor) == ("um/s", pytest.approx(1e6))
    assert growth.step() == pytest.approx(5e-11) and growth.group == "crystalliser"
    assert warm.move == 1.0 and warm.meaning == "temperature of the reactor"
    assert TEMPLATE.exists()
