"""Every class that a public function or method takes or returns is public itself."""

import importlib
import inspect
import typing
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest

import snapo
import snapo.gym

NAMES = {name: getattr(snapo, name) for name in snapo.__all__ if name != "__version__"}
CLASSES = {thing for thing in NAMES.values() if inspect.isclass(thing)}
INNER = {
    "XlaCall": "a compiled program's arguments, of the engines alone",
    "Factors": "numbers by name, as the schedule of Schwartz's prices has them",
    "Gaps": "the intervals between the times of a FactorPrice, made from them",
    "OfCost": "a measure of risk with a minus before it",
    "Array": "the type of arrays of JAX, where JAX is not loaded for a type",
    "Curvature": "how a derivative changes with the policy, behind its interval",
    "Norms": "the engines' record of adjoints, of which Growth is made",
    **dict.fromkeys(("Distributed", "Workers"), "made by solve, of the executors it is given"),
    **dict.fromkeys(
        ("Dual", "Learner", "Round", "FeatureScale", "TrainingPlan"), "what a Progress goes on with"
    ),
}


def classes(hint: Any) -> Iterator[type]:
    """The classes of the package in an annotation."""
    if inspect.isclass(hint) and not typing.get_args(hint):
        if hint.__module__.startswith("snapo."):
            yield hint
        return
    for part in typing.get_args(hint):
        for each in part if isinstance(part, list | tuple) else (part,):
            yield from classes(each)


def functions(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """The functions that a public name has: itself, or its public methods and properties."""
    if not inspect.isclass(thing):
        if inspect.isfunction(inspect.unwrap(thing)):
            yield name, inspect.unwrap(thing)
        return
    for key in dir(thing):
        found = inspect.getattr_static(thing, key)
        found = getattr(found, "fget", None) or getattr(found, "__func__", found)
        found = inspect.unwrap(found) if callable(found) else found
        shown = not key.startswith("_") or key in ("__init__", "__call__", "__getitem__")
        if shown and inspect.isfunction(found) and found.__module__.startswith("snapo."):
            yield f"{name}.{key}", found


def hints(thing: Any) -> dict[str, Any]:
    """Annotations as classes; of those that only type checkers import, only what is known."""
    try:
        return typing.get_type_hints(thing)
    except NameError as error:
        assert error.name in {*NAMES, *dir(snapo.gym)}
        return {}


def test_every_class_that_a_user_receives_or_gives_is_public():
    missing = defaultdict(set)
    for name, thing in NAMES.items():
        owned = [(name, thing)] if inspect.isclass(thing) else []
        for place, function in [*functions(name, thing), *owned]:
            for key, hint in hints(function).items():
                for kind in classes(hint):
                    if kind not in CLASSES and not kind.__name__.startswith("_"):
                        missing[kind.__name__].add(f"{place}: {key}")
    assert missing.keys() - INNER.keys() == set(), missing
    assert INNER.keys() <= missing.keys()


@pytest.mark.parametrize("name", sorted(each for each in NAMES if inspect.isclass(NAMES[each])))
def test_a_public_class_has_the_name_that_it_is_found_under(name):
    assert NAMES[name].__name__ == name and NAMES[name].__doc__


@pytest.mark.parametrize("name", snapo.MODULES)
def test_a_public_module_is_imported_by_its_public_name(name):
    module = importlib.import_module(f"snapo.{name}")
    assert module is getattr(snapo, name) and len(module.__all__) >= 2
    assert all(callable(getattr(module, member)) for member in module.__all__)
