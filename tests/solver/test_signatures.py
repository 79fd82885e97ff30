"""The functions of a problem and a policy take the same words in the same order."""

import inspect
from typing import get_type_hints

import pytest

import snapo
from snapo.problem.smooth import EXACT, Exact, Smooth

VERBS = [
    snapo.evaluate, snapo.simulate, snapo.sensitivities, snapo.value_and_gradient,
    snapo.second_order, snapo.bump_check, snapo.feasibility, snapo.bound,
]  # fmt: skip
SHARED = ("paths", "smooth", "engine")


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_all_but_the_problem_and_the_policy_goes_by_name(verb):
    parameters = inspect.signature(verb).parameters
    first = list(parameters)[:2]
    assert first == ["problem", "policy"]
    others = {name: each for name, each in parameters.items() if name not in first}
    assert all(each.kind is each.KEYWORD_ONLY for each in others.values())
    shared = [name for name in others if name in SHARED]
    assert shared == [name for name in SHARED if name in others] and "paths" in shared
    if verb is not snapo.second_order:  # which differentiates the smooth simulator
        assert list(others)[: len(shared)] == shared
        assert others.get("smooth", others["paths"]).default in (EXACT, others["paths"].default)


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_smooth_has_its_type(verb):
    smooth = get_type_hints(inspect.unwrap(verb)).get("smooth")
    assert smooth in (None, Smooth | Exact, Smooth | Exact | None)


def test_other_decisions_are_refused():
    verb = inspect.unwrap(snapo.value_and_gradient)
    with pytest.raises(ValueError, match="decisions is 'free'; it must be 'held' or 'reacting'"):
        verb(None, None, decisions="free")
