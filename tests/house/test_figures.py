"""The figures of the house may only fall: whoever makes one smaller lowers its limit with it."""

import pytest
from tests.house import tree
from tests.house.figures import FIGURES, limits

SLACK = 0.98  # a figure below this share of its limit asks for a lower one


@pytest.fixture(scope="module", autouse=True)
def trees_are_given_back():
    """They are larger than anything else in the process."""
    yield
    tree.trees.cache_clear()


def test_every_figure_has_a_limit():
    assert limits().keys() == FIGURES.keys()


@pytest.mark.parametrize("name", FIGURES)
def test_figures_only_fall(name):
    found, limit = len(FIGURES[name]()), limits()[name]
    see = f"python -m tests.house.figures {name}"
    assert found <= limit, f"{name} is {found}, and may be {limit} at most: {see}"
    assert found >= SLACK * limit, f"{name} has fallen to {found}: write that in limits.toml"
