"""A second inventory of the same form is the same program: nothing is traced or compiled for it."""

from pathlib import Path

import jax
import numpy as np
import pytest
from tests.compilations import compilations
from tests.domains.inventory.inventory_cases import case
from tests.domains.inventory.network_cases import network
from tests.domains.same_form import PAIRS, same_programs

from snapo.domains.inventory.setup import make_setup, setup_at, simulator_of
from snapo.engine.native.call import _runners
from snapo.problem.problem import Problem
from snapo.solver.learning.optimiser import schedule

QUICK = {
    "training": {"steps": 2, "paths": 64, "validation_paths": 64},
    "evaluation": {"paths": 128, "sensitivity_paths": 64, "judge_paths": 0, "search_paths": 0},
}


def demand(draw: np.random.Generator, folder: Path, name: str) -> dict:
    """A demand of any kind, with numbers that are drawn."""
    mean = float(draw.uniform(4.0, 4.5))
    history = draw.integers(0, 12, 20) + draw.choice([0.0, 0.5])
    rows = [f"{i},{amount}" for i, amount in enumerate([1, 2, *history])]
    (folder / f"{name}.csv").write_text("\n".join(["period,demand", *rows]))
    kinds = (
        {"kind": "poisson", "mean": mean},
        {"kind": "geometric", "mean": mean},
        {"kind": "negative-binomial", "mean": mean, "deviation": 3.0},
        {"kind": "normal", "mean": mean, "deviation": float(draw.uniform(0.5, 2.0))},
        {"kind": "empirical", "history": f"{name}.csv"},
        {"kind": "empirical", "history": f"{name}.csv", "mean": mean},
    )
    return kinds[draw.integers(len(kinds))]


def season(draw: np.random.Generator, folder: Path, name: str) -> dict:
    """A season of two or three periods, or none."""
    rows = [f"{i},{draw.uniform(0.5, 1.0):.3f}" for i in range(draw.integers(1, 4))]
    (folder / name).write_text("\n".join(["period,factor", *rows]))
    return {"season": {"file": name}} if len(rows) > 1 else {}


def item(draw: np.random.Generator, folder: Path) -> Problem:
    """An item whose every number is drawn, and its rules of a few."""
    lead = int(draw.integers(0, 3))
    keys = {
        "unmet": str(draw.choice(["lost", "waits"])),
        "lead_time": lead,
        "holding": float(draw.uniform(0.5, 2.0)),
        "shortage": float(draw.uniform(3.0, 9.0)),
        "purchase": float(draw.choice([0.0, 1.5])),
        "order": float(draw.choice([0.0, draw.uniform(1.0, 20.0)])),
    }
    if draw.integers(2):
        keys |= {"stock": float(draw.uniform(0, 20)), "coming": [3.0] * max(lead - 1, 0)}
    horizon = {"periods": 6, "warm_up": int(draw.integers(0, 2)) * 2}
    horizon |= {"discount": float(draw.uniform(0.9, 1.0))} if draw.integers(2) else {}
    of = case(
        demand(draw, folder, "history"),
        folder,
        horizon=horizon,
        **keys,
        **season(draw, folder, "season.csv"),
    )
    return Problem(simulator_of(of), of.inputs(), "result")


def stores(draw: np.random.Generator, folder: Path) -> Problem:
    """A depot and two stores whose every number is drawn, and their rules of a few."""

    def costs() -> dict:
        order = {"order": float(draw.uniform(1.0, 20.0))} if draw.integers(4) == 0 else {}
        return {"holding": float(draw.uniform(0.5, 2.0)), **order}

    places = [{"name": "depot", "lead_time": 1, **costs()}]
    for name in ("north", "south"):
        keys = {"shortage": float(draw.uniform(5, 9)), "supplier": "depot", "lead_time": 0}
        of = demand(np.random.default_rng(draw.integers(4)), folder, name)
        of |= {"mean": 0.1 + of["mean"] * draw.uniform(0.99, 1.0)} if "mean" in of else {}
        more = season(draw, folder, f"season_{name}.csv") if draw.integers(4) == 0 else {}
        places.append({"name": name, "demand": of, **keys, **costs(), **more})
    whens = ["after", "before"] if draw.integers(2) else []
    pools = [
        {"between": ["north", "south"], "cost": draw.uniform(0.1, 2), "when": x} for x in whens
    ]
    of = network(*places, folder=folder, horizon={"periods": 6, "warm_up": 2}, transshipment=pools)
    return Problem(simulator_of(of), of.inputs(), "result")


MAKERS = {"item": item, "network": stores}


@pytest.mark.parametrize("kind", MAKERS)
def test_equal_forms_are_equal_programs(kind, tmp_path):
    draws = (np.random.default_rng(seed) for seed in range(400))
    assert same_programs((MAKERS[kind](draw, tmp_path) for draw in draws), enough=3) >= 3


@PAIRS
@pytest.mark.parametrize("kind", MAKERS)
def test_equal_forms_are_equal_programs_in_many_pairs(kind, enough, tmp_path):
    draws = (np.random.default_rng(seed) for seed in range(4000))
    assert same_programs((MAKERS[kind](draw, tmp_path) for draw in draws), enough) >= enough


@pytest.mark.parametrize("kind", MAKERS)
def test_a_simulator_has_arrays_alone(kind, tmp_path):
    problem = MAKERS[kind](np.random.default_rng(0), tmp_path)
    leaves = jax.tree.leaves(problem.simulator)
    assert leaves and all(isinstance(leaf, np.ndarray) for leaf in leaves)
    assert not hasattr(problem.simulator, "case")


def line(cost: float, mean: float):
    """A depot with one store, where orders of both have a cost."""
    store = {"name": "shop", "supplier": "depot", "lead_time": 0, "shortage": 9.0, "order": cost}
    law = {"kind": "normal", "mean": mean, "deviation": 1.0}
    places = store | {"holding": 1.0, "demand": law}, {"name": "depot", "lead_time": 1}
    depot = places[1] | {"holding": cost / 20, "order": 20.0}
    return network(places[0], depot, horizon={"periods": 6, "warm_up": 2}, **QUICK)


def lot(cost: float, mean: float):
    """An item whose orders have a cost."""
    law = {"kind": "normal", "mean": mean, "deviation": 1.0}
    tables = {"horizon": {"periods": 6, "warm_up": 2}, **QUICK}
    return case(law, holding=cost / 10, order=cost, **tables)


@pytest.mark.prove
@pytest.mark.parametrize("made", [lot, line])
def test_a_second_inventory_compiles_nothing_and_has_its_own_bits(made):
    setup = make_setup(made(8.0, 5.0), "native")
    first = setup.solve()
    # The verdict sums the rates of all steps, where a training gained: not in every one.
    schedule(setup.training)(np.arange(setup.training.steps))
    with compilations() as compiled:
        second = make_setup(made(9.0, 5.5), "native").solve()
        moved = setup_at(setup, made(9.0, 5.5))
        third = moved.solve()
    assert compiled == []
    jax.clear_caches()
    _runners.clear()
    again = make_setup(made(9.0, 5.5), "native").solve()
    assert second.value == again.value == third.value != first.value
    for policy in (second.policy, third.policy):
        assert jax.tree.all(jax.tree.map(np.array_equal, policy, again.policy))


def test_another_form_is_made_anew():
    setup = make_setup(lot(8.0, 5.0), "native")
    other = case(horizon={"periods": 6, "warm_up": 2})
    moved = setup_at(setup, other)
    assert moved.problem.form == make_setup(other, "native").problem.form != setup.problem.form
