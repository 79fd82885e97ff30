"""Every kind of run on the page: its inputs have places, and its numbers are those of `solve`."""

import json
import shutil

import numpy as np
import pytest
from tests.domains.pharma.pharma_cases import CASE, LOOP, small
from tests.miniatures import MINIATURES

from snapo.case.error import CaseError
from snapo.live.headline import HeadlineTables
from snapo.live.moves import Recalculation, WhatIf, choices
from snapo.live.open import about_run
from snapo.live.valuation import Valuation
from snapo.live.worker import open_run
from snapo.solver.measure.measure import MeasuredRun, measure
from snapo.solver.train import initial_progress
from snapo.study import commands
from snapo.study.domain import Options
from snapo.study.positions import InputPositions
from snapo.study.positions.files import read_files
from snapo.study.run_folder import plain_json
from snapo.testing.miniature import Miniature, quiet

SHOWN = ("value", "sections", "deltas")


def places(folder, kind, size=None):
    """The places of a template's inputs."""
    commands.new(kind, folder, size)
    loaded = commands.load(commands.CaseRequest(folder))
    study = loaded.domain.study(loaded.case, Options("xla"))
    assert study.inputs is not None
    inputs, files = study.inputs(loaded.case), read_files(folder, loaded.data)
    return InputPositions(loaded.domain.read, files, inputs, study.inputs)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("kind", "size"),
    [("inventory", "spare-part"), ("inventory", "line"), ("control", "linear-quadratic"),
     ("control", "two-tanks"), ("pharma", "standard")],
)  # fmt: skip
def test_every_input_has_its_place(tmp_path, kind, size):
    found = places(tmp_path / "case", kind, size)
    assert [name for name in found.inputs if name not in found.recorded] == []


def opened(run, folder) -> WhatIf:
    shutil.copytree(run, folder / "run")
    return open_run(folder / "run")


def plain(table):
    return json.loads(json.dumps(plain_json(table)))


def shown(valuation: WhatIf, values):
    found = {}
    for name, table in valuation.stages(values):
        found[name] = plain(table)
        if name == SHOWN[-1]:
            return found
    return found


def moved_case(valuation: WhatIf, values, folder):
    """The case that the page writes, read again as `snapo solve` reads it."""
    valuation.files(values).write(folder)
    return commands.load(commands.CaseRequest(folder))


def as_solved(valuation, values, folder):
    """Value and sensitivities of the moved case by `solve`, with the run's policy."""
    assert isinstance(valuation, Valuation)
    loaded = moved_case(valuation, values, folder)
    study = loaded.domain.study(loaded.case, Options())
    assert study.setup is not None
    setup, policy = study.setup(), valuation.solution.policy
    assert policy is not None
    from dataclasses import replace

    asked = replace(setup.evaluation, smooth_paths=0, judge_paths=0, selection_paths=0)
    state = replace(initial_progress(policy, setup.training), best=policy)
    return measure(MeasuredRun(setup.problem, policy, state, setup.training, asked, setup.engines))


@pytest.mark.prove
@pytest.mark.parametrize(
    ("kind", "values"),
    [("inventory", {"demand_mean": 1.05, "holding_cost": 1.5}),
     ("control", {"plant.mass": 1.1, "start.position.mean": 0.9})],
)  # fmt: skip
def test_the_page_shows_what_solve_finds(kind, values, solved, tmp_path):
    valuation = opened(solved(kind) / "run", tmp_path)
    moved = {name: x * valuation.inputs_by_name[name].value.ravel() for name, x in values.items()}
    base, found = shown(valuation, {}), shown(valuation, moved)
    again = as_solved(valuation, moved, tmp_path / "moved")
    assert found["value"]["value"] == again["value"] != base["value"]["value"]
    assert found["value"]["standard_error"] == again["standard_error"]
    held = as_solved(valuation, {}, tmp_path / "case")["sensitivities"].held
    for row in found["deltas"]:
        if len(row["rows"]) == 1:
            name, one = row["input"], np.ones(valuation.inputs_by_name[row["input"]].value.shape)
            change = again["sensitivities"].held[name].value - held[name].value
            value = valuation.solution.sensitivities.along(name, one).value + float(change.sum())
            assert row["rows"][0]["value"] == pytest.approx(value, rel=1e-9)
            assert row["rows"][0]["low"] <= row["rows"][0]["value"] <= row["rows"][0]["high"]
    rows = {row[0]: row for each in found["sections"] for row in each["rows"]}
    if kind == "inventory":
        costs = [row[1] for row in found["sections"][1]["rows"]]
        assert sum(costs) == pytest.approx(-found["value"]["value"], rel=1e-12)
        assert 0 < rows["fill rate, %"][1] <= 100
    else:
        assert rows["reward"][1] == found["value"]["value"]
    assert shown(valuation, {})["value"] == base["value"]
    rows = valuation.explained(moved)
    assert [row["names"] for row in rows] == [[name] for name in values]
    change = sum(row["change"] for row in rows)
    assert change == pytest.approx(found["value"]["change"], rel=1e-9)


@pytest.mark.prove
def test_a_process_without_a_policy_is_calculated_as_solve_does(solved, tmp_path):
    valuation = opened(solved("pharma") / "run", tmp_path)
    assert isinstance(valuation, Recalculation)
    wanted = {"reactor.temperature": [313.9], "charge.concentration": None}
    feed = valuation.inputs_by_name["charge.concentration"].value.copy()
    feed[feed > 0] *= 1.03
    moved = {name: feed if x is None else np.array(x) for name, x in wanted.items()}
    base, found = shown(valuation, {}), shown(valuation, moved)
    assert found["value"]["value"] != base["value"]["value"]
    loaded = moved_case(valuation, moved, tmp_path / "moved")
    result = Miniature("pharma", assignments=('report.parts=["capability", "all sensitivities"]',))
    assert loaded.case.attributes
    out = tmp_path / "again"
    solved_anew = commands.solve(
        commands.CaseRequest(tmp_path / "moved", result.assignments), quiet, out=out
    )
    assert found["value"]["value"] == solved_anew["value"]
    assert found["value"]["standard_error"] == solved_anew["standard_error"]
    rows = (out / "attribute_sensitivities.csv").read_text().splitlines()[1:]
    slopes = {tuple(row.split(",")[:3]): float(row.split(",")[3]) for row in rows}
    for row in found["deltas"]:
        for each in row["rows"]:
            assert each["value"] == slopes[row["of"], row["input"], each["label"]]
    section = found["sections"][0]
    assert section["rows"][0][:3] == ["product", "at least 0.11\u00a0mol/L", "mol/L"]
    assert valuation.settings() == {} and valuation.units()["unit"] == ""


@pytest.mark.study
def test_a_process_in_closed_loop_is_valued_as_solve_does(tmp_path):
    mini = Miniature("pharma", texts=lambda: {"case.toml": small(CASE + LOOP)},
                     assignments=('report.parts=["training"]', "training.steps=2"))  # fmt: skip
    mini.solve(tmp_path)
    valuation = open_run(tmp_path / "run")
    moved = {"kinetics.prefactor": 1.1 * valuation.inputs_by_name["kinetics.prefactor"].value}
    found = shown(valuation, moved)
    again = as_solved(valuation, moved, tmp_path / "moved")
    assert found["value"]["value"] == again["value"]
    assert found["value"]["standard_error"] == again["standard_error"]
    (section,) = found["sections"]
    assert [row[0] for row in section["rows"]] == ["product", "impurity"]
    assert "meet all limits" in section["description"]


@pytest.mark.prove
def test_a_fund_shows_todays_trades_and_its_outcome_in_ratios(solved):
    valuation = open_run(solved("pension") / "run")
    assert isinstance(valuation, Valuation) and valuation.study.today is not None
    result = valuation.study.today(valuation.setup, valuation.policy)
    part = json.loads((solved("pension") / "run" / "parts" / "today.json").read_text())
    for row, trade in zip(result.rows, part["trades"]["classes"], strict=True):
        assert row[0] == trade["name"]
        targets = 100 * trade["target"], trade["trade"] * 1e-6
        assert (row[3], row[6]) == pytest.approx(targets, rel=1e-4, abs=1e-3)
    largest = max(part["trades"]["classes"], key=lambda trade: abs(trade["trade"]))
    side = "buy" if largest["trade"] > 0 else "sell"
    assert result.description.startswith(side) and largest["name"] in result.description
    stages = valuation.stages({})
    raw, (table,) = next(stages)[1], next(stages)[1]
    value, shown = raw["value"], HeadlineTables(valuation)
    rows = {row[0]: row[1] for row in table["rows"]}
    certain = json.loads((solved("pension") / "run" / "parts" / "objective.json").read_text())[
        "objective"
    ]
    assert certain["value"] == pytest.approx(value, rel=1e-12)
    assert rows["Certainty equivalent of the value, %"] == pytest.approx(
        100 * certain["equivalent"], rel=1e-9
    )
    headline = shown.table("value", raw)  # the page begins with the ratio, not with the utility
    assert headline["value"] == pytest.approx(100 * certain["equivalent"], rel=1e-9)
    assert shown.units()["unit"] == "%" and "funding ratio" in shown.units()["meaning"]
    assert about_run(solved("pension") / "run")["meaning"] == shown.units()["meaning"]
    assert rows["Funding ratio, mean of the worst 5 %, %"] < rows["Mean funding ratio, %"]


@pytest.mark.prove
def test_a_choice_is_valued_as_solve_does(solved, tmp_path):
    valuation = opened(solved("inventory") / "run", tmp_path)
    assert isinstance(valuation, Valuation) and not valuation.bounded
    (choice,) = [x for x in valuation.choices if x.name == "item.unmet"]
    (other,) = [x for x in choice.allowed if x != choice.value]
    chosen = {choice.name: other}
    base = next(valuation.stages({}))[1]
    found = next(valuation.stages({}, chosen))[1]
    valuation.files({}, chosen).write(tmp_path / "moved")
    loaded = commands.load(commands.CaseRequest(tmp_path / "moved"))
    setup = loaded.domain.study(loaded.case, Options()).setup
    assert setup is not None
    assert found["value"] == valuation._totals_worth(setup())[1].value != base["value"]
    with pytest.raises(CaseError, match="there is no such choice"):
        next(valuation.stages({}, {"contract.nothing": "x"}))
    with pytest.raises(CaseError, match="it must be"):
        next(valuation.stages({}, {choice.name: "; rm -rf"}))


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        ("gas-storage", {"contract.ratchet_interpolation": "linear",  # stands in the case
                         "contract.first_decision": "valuation-date"}),  # its default
        pytest.param("pharma", {"units.crystalliser.separate": False, "numerics.method": "auto"},
                     marks=pytest.mark.prove),
    ],
)  # fmt: skip
def test_choices_are_those_of_the_format_whether_the_case_names_them_or_not(kind, wanted, tmp_path):
    commands.new(kind, tmp_path, None)
    loaded = commands.load(commands.CaseRequest(tmp_path))
    files = read_files(tmp_path, loaded.data)

    def again(files):
        return loaded.domain.read(files.write(tmp_path / "again"), files.tables)

    found = {each.name: each for each in choices(files, again)}
    assert {name: found[name].value for name in wanted} == wanted
    for each in found.values():
        assert each.value == each.allowed[0] and len(set(each.allowed)) == len(each.allowed) > 1
        again(files.with_value(each.key, each.allowed[-1]))  # which the reader takes


@pytest.mark.prove
def test_the_best_is_bounded_where_the_domain_can(solved, tmp_path):
    valuation = opened(solved("gas-storage") / "run", tmp_path)
    assert isinstance(valuation, Valuation) and valuation.bounded
    bounds = valuation.bound_here(
        {"volatility": 1.1 * valuation.inputs_by_name["volatility"].value}
    )
    assert bounds["lower"]["value"] <= bounds["upper"]["value"]


def test_the_miniatures_hold_every_kind():
    assert {"inventory", "control", "pharma"} <= set(MINIATURES)
