"""Domains are found by their entry points, and one that cannot be used says why."""

import pytest
from tests.study.fake import DOMAIN, install

from snapo.case.error import CaseError
from snapo.study import domain as domains
from snapo.study.domain import Domain, RunsCode, find, installed


@pytest.fixture(autouse=True)
def clean():
    yield
    domains.installed.cache_clear()


def message(*arguments) -> str:
    with pytest.raises(CaseError) as caught:
        find(*arguments)
    return str(caught.value)


def test_the_kinds_of_this_package_are_installed():
    domains.installed.cache_clear()
    assert {"gas-storage", "own", "pension", "pharma"} <= set(installed())


def test_a_domain_is_found_by_its_kind(fake):
    assert find("fake", "case.toml") is DOMAIN
    assert isinstance(DOMAIN, Domain)
    assert not isinstance(DOMAIN, RunsCode)


def test_an_unknown_kind_names_the_nearest(fake):
    expected = (
        'case.toml, kind: got \'fakes\'; it must be one of "fake", or "book" in a file for '
        "snapo book; the nearest known kind is "
    )
    assert message("fakes", "case.toml").startswith(expected + "fake")
    assert 'this key is missing; it is one of "fake"' in message(None, "case.toml")
    assert "got 3" in message(3, "case.toml")


def test_a_domain_that_cannot_be_loaded(monkeypatch):
    install(monkeypatch, lost="no_such_module:DOMAIN", empty="tests.study.fake:NOTHING")
    assert "no_such_module:DOMAIN cannot be loaded" in message("lost", "case.toml")
    assert "has no attribute 'NOTHING'" in message("empty", "case.toml")


def test_an_object_that_is_no_domain_says_what_it_lacks(monkeypatch):
    install(monkeypatch, wrong="tests.study.fake:FakeCase")
    assert "is not a domain: it has no kind, description" in message("wrong", "case.toml")


def test_no_domain_at_all(monkeypatch):
    install(monkeypatch)
    assert "no kind of case is installed" in message("fake", "case.toml")


def test_two_packages_with_the_same_kind(monkeypatch):
    from importlib.metadata import EntryPoint

    twice = [EntryPoint("fake", value, domains.GROUP) for value in ("one:A", "two:B")]
    monkeypatch.setattr(domains, "entry_points", lambda group: twice)
    domains.installed.cache_clear()
    assert "two packages provide the same kind: one:A and two:B" in message("fake", "case.toml")
