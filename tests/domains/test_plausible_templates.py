"""No example of any kind looks like a slip of units: none has a note that supposes one."""

from pathlib import Path

import pytest

from snapo.study.domain import CaseRequest, RunsCode, find, installed, load

ROOT = Path(__file__).parents[2]
TEMPLATES = [(kind, size) for kind in installed() for size in find(kind, "KIND").templates]
# Each says something else: what was read, or what a policy needs.
OTHER = ("is extrapolated", "are extrapolated", "has no memory")


@pytest.mark.parametrize(("kind", "size"), TEMPLATES)
def test_no_template_has_a_note_on_units(kind, size):
    domain = find(kind, "KIND")
    code = tuple(domain.example.split(":")) if isinstance(domain, RunsCode) else None
    case = load(CaseRequest(Path(str(domain.templates[size])), (), code)).case
    assert not [note for note in case.notes if not any(item in note for item in OTHER)]


@pytest.mark.parametrize("file", sorted(ROOT.glob("examples/**/case.toml")), ids=str)
def test_no_example_has_a_note_on_units(file):
    if "newsvendor" in str(file):
        pytest.importorskip("snapo_newsvendor")
    assert not load(CaseRequest(file)).case.notes
