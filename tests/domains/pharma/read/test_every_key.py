"""Every key of the template, and of a case with the other unit operations, spoilt in turn."""

import pytest
from tests.domains.pharma.pharma_cases import TEMPLATE
from tests.domains.pharma.units.test_msmpr import CASE, with_attributes

from snapo.domains.pharma import DOMAIN
from snapo.testing.mistakes import refusals, spoilt_keys

# Tables whose keys are names of the owner's own choice.
FREE = ("species", "feeds", "units", "feeds.charge.concentration")


@pytest.mark.prove
@pytest.mark.parametrize("which", ["template", "continuous"])
def test_no_mistake_ends_in_a_traceback(which, tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    text = TEMPLATE.read_text(encoding="utf-8") if which == "template" else with_attributes(CASE)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    complaints = refusals(DOMAIN.read, folder, spoilt_keys(folder, FREE), tmp_path / "scratch")
    assert not complaints, "\n".join(complaints)
