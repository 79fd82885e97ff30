"""A run's case studied again: the checks that it passed are not done again for the same code."""

import pytest

from snapo.study.domain import Options, RunsCode
from snapo.study.prepare import options_of_run

ABOUT = {"title": "mine", "notes": []}


class Coded:
    """All that is asked of a domain that runs code; a case is its code's hash."""

    example = "simulator:Mine"

    def with_simulator(self, module, name):
        return self

    def decides(self, case):
        return {"simulator file": case}


@pytest.mark.parametrize(("hash", "known"), [("old", ABOUT), ("new", None)])
def test_changed_code_is_checked_again(hash, known):
    domain = Coded()
    assert isinstance(domain, RunsCode)
    record = {"decides": {"options": {"engine": "auto", "simulator file": "old"}}, "about": ABOUT}
    assert options_of_run(domain, hash, record, "xla") == Options("xla", about=known)  # pyright: ignore


def test_a_case_without_code_passed_its_checks():
    record = {"decides": {"options": {}}, "about": ABOUT}
    assert options_of_run(object(), None, record, "auto").about == ABOUT  # pyright: ignore
