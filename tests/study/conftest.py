"""The fake domain in place of the installed ones."""

import pytest
from tests.study.fake import DONE, install

from snapo.study import carry_out
from snapo.study import domain as domains


@pytest.fixture
def fake(monkeypatch):
    """The parts that the fake domain works out, in order."""
    install(monkeypatch, fake="tests.study.fake:DOMAIN")
    DONE.clear()
    yield DONE
    domains.installed.cache_clear()


@pytest.fixture
def case(tmp_path):
    """A folder with a case of the fake domain."""
    folder = tmp_path / "case"
    folder.mkdir()
    (folder / "case.toml").write_text('kind = "fake"\nnumbers = [1, 2, 4]\n')
    return folder


@pytest.fixture
def without_page(monkeypatch):
    """No report is drawn, which takes most of a small run: for tests that do not look at it."""
    monkeypatch.setattr(carry_out, "write_report", lambda domain, folder: folder / "report.html")
