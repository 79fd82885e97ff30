"""Seasons of places: levels and demand by period, derivatives, refusals, and what is reported."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.inventory.network_cases import network

from snapo.case.error import CaseError
from snapo.domains.inventory.network.rules import echelon_rule, first_levels
from snapo.domains.inventory.setup import make_setup
from snapo.engine import Native, Xla
from snapo.problem.smooth import Smooth
from snapo.solver.adjoint import value_and_gradient
from snapo.solver.evaluate import evaluate, path_totals

NORMAL = {"kind": "normal", "mean": 4.0, "deviation": 1.0}
STORE = {"supplier": "centre", "lead_time": 0, "holding": 2.0, "shortage": 15.0, "demand": NORMAL}
CENTRE = {"name": "centre", "lead_time": 1, "holding": 1.0}
YEAR = [0.5, 1.5]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "s.csv").write_text("period,factor\nsummer,0.5\nwinter,1.5\n")
    return tmp_path


def stores(folder, north=None, south=None, **tables):
    """A centre and two stores, the first of which has a season."""
    tables = {"horizon": {"periods": 6, "warm_up": 1}} | tables
    first = STORE | {"name": "north", "season": {"file": "s.csv"}} | (north or {})
    return network(CENTRE, first, STORE | {"name": "south"} | (south or {}), folder=folder,
                   **tables)  # fmt: skip


def test_levels_cover_the_demand_ahead_of_every_place(folder):
    case = stores(folder)
    steps = make_setup(case).problem.schedule.steps
    assert case.network.seasonal and case.network.cover.tolist() == [3, 1, 1]
    north = 4 * np.resize(YEAR, 12)
    z = (steps["level"][:, 2] - 4) / 1.0  # the store without a season, of deviation 1
    assert np.ptp(z) == 0 and z[0] > 1
    assert steps["level"][:, 1] == pytest.approx(north[:7] + z[0] * north[:7] / 4)
    assert steps["mean"][:, 1] == pytest.approx(north[:7])
    ahead = [north[t : t + 3].sum() + 12 for t in range(7)]
    variance = [np.sum((north[t : t + 3] / 4) ** 2) + 3 for t in range(7)]
    rest = (steps["level"][:, 0] - ahead) / np.sqrt(variance)
    assert np.ptp(rest) == pytest.approx(0, abs=1e-5)
    assert first_levels(make_setup(case)) == pytest.approx(steps["level"][1])


def test_a_season_is_an_input_of_its_place(folder):
    given = stores(folder).inputs()
    assert given["north.season"].labels == ("summer", "winter") and "south.season" not in given
    case = stores(folder, north={"demand": {"kind": "poisson", "mean": 4.0}},
                  south={"demand": {"kind": "poisson", "mean": 4.0}})  # fmt: skip
    assert case.network.integer
    assert make_setup(case).problem.simulator.in_mean() == (
        "north.demand_mean", "north.season", "south.demand_mean",
    )  # fmt: skip


@pytest.mark.parametrize(
    "season, text, where, allowed",
    [
        ({"file": "other.csv"}, "", "place[1].season.file", "other.csv"),
        ({}, "", "place[1].season.file", "missing"),
        ({"file": "s.csv", "from": 3}, "", "place[1].season.from", "no such key"),
        ({"file": "bad.csv"}, "period,factor\na,-1\nb,2\n", "line 2, column factor", "0.001"),
        ({"file": "bad.csv"}, "period,factor\na,1\n", "", "2 to 366 are allowed"),
        ({"file": "bad.csv"}, "period,demand\na,1\nb,1\n", "", "factor"),
    ],
)
def test_a_wrong_season_is_refused_in_words(folder, season, text, where, allowed):
    (folder / "bad.csv").write_text(text or "period,factor\na,1\nb,1\n")
    with pytest.raises(CaseError) as found:
        stores(folder, north={"season": season})
    assert where in found.value.where and allowed in str(found.value)
    assert found.value.file.endswith("bad.csv" if text else "case.toml")


def test_a_place_without_customers_has_no_season(folder):
    store = STORE | {"name": "south"}
    with pytest.raises(CaseError, match="only a place with customers can have a season") as found:
        network(CENTRE | {"season": {"file": "s.csv"}}, store, folder=folder)
    assert found.value.where == "place[0].season"


@pytest.mark.prove
def test_derivatives_are_differences_and_both_engines_agree(folder):
    """Smooth, in double precision: costs, moments and every factor of the season."""
    pools = [{"between": ["north", "south"], "cost": 1.0, "when": "before"}]
    setup = make_setup(stores(folder, transshipment=pools))
    problem, policy, smooth = setup.problem, setup.policy, Smooth(jnp.asarray(0.02))
    engine = Native("float64")
    (first, one), (second, other) = (
        value_and_gradient(problem, policy, paths=256, smooth=smooth, engine=each)
        for each in (engine, Xla("float64"))
    )
    assert first == pytest.approx(second, rel=1e-10)
    for name, slope in one.inputs.items():
        assert slope == pytest.approx(other.inputs[name], rel=1e-7, abs=1e-10), name
        value = np.asarray(problem.inputs_by_name[name].value, np.float64)
        for k in range(value.size):
            step = np.zeros(value.size)
            step[k] = 1e-4
            ends = [
                evaluate(problem.at({name: value + way * step.reshape(value.shape)}), policy, paths=256,
                         smooth=smooth, engine=engine).value
                for way in (1, -1)
            ]  # fmt: skip
            found = (ends[0] - ends[1]) / 2e-4
            assert np.ravel(slope)[k] == pytest.approx(found, rel=1e-4, abs=1e-6), (name, k)


@pytest.mark.prove
def test_demand_and_service_follow_the_season(folder):
    """Means by place over whole seasons, of exact paths; the share of demand met stays a share."""
    setup = make_setup(stores(folder, horizon={"periods": 20, "warm_up": 10}))
    rule = echelon_rule(setup, (0.0, 0.0, 0.0))
    totals = path_totals(setup.problem, rule, 8192, engine=setup.engines.evaluate)
    means = {name: float(np.mean(each)) for name, each in totals.items()}
    assert means["demand_north"] == pytest.approx(4.0, rel=0.01)
    assert means["demand_south"] == pytest.approx(4.0, rel=0.01)
    assert 0.7 < means["sold_north"] / means["demand_north"] < 1
    assert means["sold"] == pytest.approx(means["sold_north"] + means["sold_south"], rel=1e-5)
