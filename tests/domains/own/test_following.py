"""A case without [training] is trained as `snapo.solve` trains without settings."""

import json
from pathlib import Path

import jax
import pytest

import snapo
from snapo.case.load import load
from snapo.domains.control import DOMAIN as CONTROL
from snapo.domains.control.study import make_setup as make_plant
from snapo.domains.own import DOMAIN
from snapo.domains.own.study import make_setup
from snapo.solver.learning.features import scale_of, undrawn
from snapo.solver.learning.settings import resolve_auto
from snapo.study import commands
from snapo.study.commands import CaseRequest
from snapo.testing.miniature import quiet

CALL = """
from examples import max_call


class MaxCall(max_call.MaxCall):
    noise_size: int = 5
"""

CASE = """
kind = "own"
[objective]
output = "cash"
[inputs]
spot = { value = 100, unit = "EUR" }
strike = { value = 100, unit = "EUR" }
rate = { value = 0.05, unit = "1/year" }
dividend = { value = 0.1, unit = "1/year" }
volatility = { value = 0.2, unit = "1" }
"""
CODE = ("simulator", "MaxCall")
SHORT = "[training]\nsteps = 6\npaths = 64\nvalidation_every = 2\nvalidation_paths = 256\n"
LITTLE = "[evaluation]\npaths = 512\nsensitivity_paths = 256\njudge_paths = 0\nsearch_paths = 0\n"


def write(folder: Path, more: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "simulator.py").write_text(CALL)
    (folder / "case.toml").write_text(CASE + more)
    return folder


def setup_of(folder: Path, more: str = ""):
    case = DOMAIN.with_simulator(*CODE).read(*load(write(folder, more)))
    return make_setup(case, "native")


def test_what_is_left_out_is_what_solve_takes(tmp_path):
    setup = setup_of(tmp_path)
    recipe = snapo.MLP()
    made = recipe.for_problem(setup.problem.interface, jax.random.key(0))
    assert setup.training == resolve_auto(snapo.Training(), setup.problem, made)
    assert setup.training.steps == 3840 and setup.training.paths == 512
    assert setup.recipe is not None and undrawn(setup.recipe)
    assert scale_of(setup.policy, setup.problem) is not None


def test_what_is_given_stays_and_the_rest_follows_it(tmp_path):
    setup = setup_of(tmp_path, "[training]\nsteps = 300\n")
    assert (setup.training.steps, setup.training.paths) == (300, 512)
    training = setup.training
    assert (training.learning_rate, training.decay, training.exploration) == (0.01, 0.0, 0.0)
    given = setup_of(tmp_path, "[training]\ndecay = 0.3\nexploration = 0.4\n").training
    assert (given.decay, given.exploration) == (0.3, 0.4)


def test_a_plant_without_settings_is_trained_as_solve_does():
    file, data = load(CONTROL.templates["double-integrator"] / "case.toml")
    for table in ("training", "policy"):
        del data[table]
    setup = make_plant(CONTROL.read(file, data), "xla")
    recipe = snapo.MLP()
    made = recipe.for_problem(setup.problem.interface, jax.random.key(0))
    assert setup.training == resolve_auto(snapo.Training(), setup.problem, made)
    assert setup.recipe is not None and undrawn(setup.recipe)


def trained(folder: Path, *stops: str) -> float:
    """The value of a run that ends before the parts that come after its training. It is also
    interrupted at the progress lines that begin with `stops`, and goes on."""
    for i, stop in enumerate((*stops, "distribution")):
        seen = []

        def tell(line: str, stop: str = stop, seen: list = seen) -> None:
            if not seen and line.startswith(stop):
                seen.append(line)
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            commands.solve(CaseRequest(folder, (), CODE), tell, resume=i > 0, engine="native")
        assert seen
    return json.loads((folder / "run" / "parts" / "training.json").read_text())["solution"]["value"]


@pytest.mark.prove
def test_a_run_is_that_of_solve_to_the_bit_and_goes_on_to_the_bit(tmp_path):
    """On features that are scaled, since it is about stopping; also where the run is interrupted."""
    setup = setup_of(tmp_path / "one", SHORT + LITTLE)
    plan = snapo.Training(steps=6, paths=64, validation_every=2, validation_paths=256)
    solution = snapo.solve(
        setup.problem, training=plan, evaluation=setup.evaluation, engine="native"
    )
    assert solution.convergence
    assert trained(tmp_path / "one") == solution.value
    assert trained(write(tmp_path / "two", SHORT + LITTLE), "step     2") == solution.value
    history = [(tmp_path / name / "run" / "history.csv").read_text() for name in ("one", "two")]
    rows = [[line.rsplit(",", 5)[0] for line in each.splitlines()] for each in history]
    assert rows[0] == rows[1]


@pytest.mark.study
def test_a_max_call_of_five_by_the_command_line(tmp_path):
    """Within .5 % of 26.14 (Andersen and Broadie 2004). With 240 steps on features as they are, as
    the command line once trained, it ended at the European value: 23.07."""
    found = commands.solve(CaseRequest(write(tmp_path), (), CODE), quiet)
    assert found["value"] == pytest.approx(26.14, rel=0.005)
