"""Plants seen through errors of measurement: what is observed, and the best cost in closed form."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import snapo
from snapo.case.load import load
from snapo.domains.control import DOMAIN
from snapo.domains.control.inputs import make_inputs
from snapo.domains.control.plants.double_integrator import DoubleIntegrator
from snapo.domains.control.plants.linear import LinearQuadratic
from snapo.domains.control.plants.mountain_car import MountainCar
from snapo.domains.control.regulator import (
    Linearised,
    estimation_cost,
    expected_cost,
    optimum,
    riccati,
)
from snapo.domains.control.study import make_setup, plant_at, recipe
from snapo.engine import Native, Xla
from snapo.problem.inputs import plain
from snapo.study import commands
from snapo.testing.miniature import Miniature


def case(**tables):
    """The template with other keys: {table: {key: value}}."""
    file, data = load(DOMAIN.templates["measured"] / "case.toml")
    return DOMAIN.read(file, data | {name: data[name] | keys for name, keys in tables.items()})


def best(of) -> float:
    found = optimum(plant_at(of), plain(of.inputs))
    assert found is not None
    return found


def filtered(linear: Linearised, mean, start, shake, errors, steps: int, paths: int) -> np.ndarray:
    """[paths] the cost of Kalman's filter with Riccati's gains, simulated."""
    rng, size = np.random.default_rng(1), len(mean)
    gains = riccati(linear, steps).K
    x = mean + np.sqrt(start) * rng.normal(size=(paths, size))
    guess, prior, total = np.tile(mean, (paths, 1)), np.diag(start), np.zeros(paths)
    for gain in gains:
        seen = x + errors * rng.normal(size=x.shape)
        weight = prior @ np.linalg.inv(prior + np.diag(errors**2))
        guess, known = guess + (seen - guess) @ weight.T, prior - weight @ prior
        u = -guess @ gain.T
        total += np.sum(x @ linear.Q * x, axis=1) + np.sum(u @ linear.R * u, axis=1)
        x = x @ linear.A.T + u @ linear.B.T + shake * rng.normal(size=x.shape)
        guess = guess @ linear.A.T + u @ linear.B.T
        prior = linear.A @ known @ linear.A.T + np.diag(shake**2)
    return total + np.sum(x @ linear.Q_T * x, axis=1)


@pytest.mark.prove
def test_the_closed_form_is_what_kalmans_filter_costs():
    """Simulated apart, on a hundred thousand paths."""
    A, B = np.array([[1.0, 0.2], [0.0, 1.0]]), np.array([[0.0], [0.2]])
    Q = np.diag([1.0, 0.1])
    linear = Linearised(A, B, Q, 0.1 * np.eye(1), np.zeros((2, 1)), Q)
    mean, start = np.array([1.0, 0.0]), np.array([0.25, 0.25])
    shake, errors = np.array([0.02, 0.1]), np.array([0.3, 0.5])
    found, cost = riccati(linear, 40), filtered(linear, mean, start, shake, errors, 40, 100_000)
    covariances = np.diag(start), np.diag(shake**2)
    known = expected_cost(found, mean, *covariances)
    known += estimation_cost(linear, found, *covariances, np.diag(errors**2))
    error = cost.std() / np.sqrt(cost.size)
    assert error < 2e-3 * known and abs(cost.mean() - known) < 4 * error
    assert -best(case()) == pytest.approx(known, rel=1e-12)


def test_without_errors_it_is_riccatis():
    exact = case(measurement={"x": [0.0, 0.0]})
    file, data = load(DOMAIN.templates["measured"] / "case.toml")
    plain_case = DOMAIN.read(
        file, {name: each for name, each in data.items() if name != "measurement"}
    )
    assert best(exact) == pytest.approx(best(plain_case), rel=1e-12)
    assert best(case()) < best(exact)
    start = {"x": {"low": np.array([0.0, -1.0]), "high": np.array([1.0, 1.0])}}
    given = plain(case().inputs)
    uniform = make_inputs(
        LinearQuadratic, given["plant"], given["cost"], start, None, given["measurement"]
    )
    plant = LinearQuadratic(uniform, 40)
    assert optimum(plant, plain(uniform)) is None  # the filter is not the best rule there


def test_the_policy_sees_errors_and_the_cost_does_not():
    """A position that is measured, and a speed that is seen as it is."""
    inputs = make_inputs(
        DoubleIntegrator, {}, {}, {"position": {"at": 2.0}, "speed": {"at": 0.0}},
        {"speed": 0.1}, {"position": 0.5},
    )  # fmt: skip
    plant = DoubleIntegrator(inputs, 3)
    assert (plant.noise_size, plant.initial_noise_size) == (2, 1)
    schedule = plant.prepare(plain(inputs))
    now = {name: each[0] for name, each in schedule.steps.items()}
    state = plant.initial(schedule.constants, jnp.array([1.0]))
    seen = plant.observe(schedule.constants, now, state)
    assert seen.tolist() == pytest.approx([2.5, 0.0, 1.0])
    noise, idle = jnp.array([1.0, -2.0]), jnp.zeros(1)
    after, outputs = plant.step(schedule.constants, now, state, idle, noise, snapo.Exact())
    assert float(outputs["reward"]) == pytest.approx(-4.0)  # of the position as it is
    assert float(after["position"]) == 2.0 and float(after["speed"]) == pytest.approx(0.1)
    assert float(after["measurement"]["position"]) == pytest.approx(1.0)
    bare = {name: after[name] for name in ("position", "speed")}
    assert float(plant.observe(schedule.constants, now, bare)[0]) == 2.0


def test_a_car_is_measured_in_every_step():
    """The errors have independent draws, and the goal is that of the true position."""
    start = {"position": {"at": 0.44}, "speed": {"at": 0.05}}
    inputs = make_inputs(MountainCar, {}, {}, start, None, {"speed": 0.01})
    plant = MountainCar(inputs, 3)
    schedule = plant.prepare(plain(inputs))
    now = {name: each[0] for name, each in schedule.steps.items()}
    state = plant.initial(schedule.constants, jnp.array([1.0]))
    assert float(state["measurement"]["speed"]) == pytest.approx(0.06)
    noise, idle = jnp.array([-2.0]), jnp.zeros(1)
    after, outputs = plant.step(schedule.constants, now, state, idle, noise, snapo.Exact())
    assert after.keys() == state.keys() == {"position", "speed", "alive", "measurement"}
    speed = 0.05 - 0.0025 * np.cos(3 * 0.44)
    assert float(after["speed"]) == pytest.approx(speed, rel=1e-6)
    assert float(after["position"]) == pytest.approx(0.44 + speed, rel=1e-6)
    assert float(after["measurement"]["speed"]) == pytest.approx(speed - 0.02, rel=1e-6)
    assert float(outputs["prize"]) == 100.0 and float(after["alive"]) == 0.0
    seen = plant.observe(schedule.constants, now, after)
    assert float(seen[1]) == pytest.approx((speed - 0.02) / 0.07, rel=1e-5)


def test_memories_are_chosen_in_the_case():
    memory = recipe(case())
    assert isinstance(memory, snapo.GRU) and memory.hidden == 16
    recent = recipe(case(policy={"memory": "Recent", "hidden": [8, 8], "steps": 3}))
    assert isinstance(recent, snapo.LastObservations) and recent.steps == 3
    assert case(policy={"memory": None}).notes[0].startswith("States are measured with errors")
    assert not case().notes


@pytest.mark.prove
def test_engines_agree_and_derivatives_are_right():
    """By the errors of measurement too, with what a recurrent policy remembers."""
    of = case(plant={"horizon": 5})
    setup = make_setup(of, "xla")
    problem, policy = setup.problem, setup.policy
    values = [
        snapo.value_and_gradient(problem, policy, paths=64, engine=engine("float64"))
        for engine in (Xla, Native)
    ]
    (one, slopes), (other, theirs) = values
    assert one == pytest.approx(other, rel=1e-12)
    name, step = "measurement.x", 1e-5
    assert np.allclose(slopes.inputs[name], theirs.inputs[name], rtol=1e-9)
    x = np.array([0.3, 0.5])
    for i in range(2):
        ends = []
        for sign in (1, -1):
            moved = problem.at({name: x + sign * step * np.eye(2)[i]})
            ends.append(snapo.value_and_gradient(moved, policy, paths=64)[0])
        assert slopes.inputs[name][i] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)


@pytest.mark.prove
def test_a_measured_plant_is_solved_to_its_report(tmp_path, sketched):
    """With a memory of either kind, from the file to the page; few steps."""
    little = ("plant.horizon=6", "training.steps=4", "training.paths=32", "evaluation.paths=256")
    more = ("evaluation.judge_paths=0", "evaluation.search_paths=0")
    more += ("evaluation.sensitivity_paths=64", 'policy.memory="Recent"', "policy.steps=3")
    for name, keys in (("gru", little), ("recent", (*little, *more))):
        result = Miniature("control", "measured", keys).solve(tmp_path / name)
        assert result["status"] == "trained" and not result["failures"], result
        run = tmp_path / name / "run"
        assert json.loads((run / "parts" / "rivals.json").read_text())["optimum"]
        assert commands.report(run).exists()
        assert len(
            json.loads((run / "parts" / "plane-of-states.json").read_text())["plane"]["action"]
        )


@pytest.mark.study
@pytest.mark.parametrize("seed", range(4))
def test_a_recurrent_policy_comes_within_a_hundredth_of_the_best(seed):
    """The template as it is, by default settings; a policy that remembers nothing does not."""
    setup = make_setup(case(training={"seed": seed}), "auto")
    evaluation = snapo.Evaluation(32768, 0, 0, 0, scenarios="sobol")
    problem = snapo.Problem(
        setup.problem.simulator, setup.problem.inputs, setup.problem.objective,
        evaluation.sources(seed),
    )  # fmt: skip
    solution = snapo.solve(
        problem, policy=setup.policy, training=setup.training, evaluation=evaluation
    )
    known = best(case())
    print(f"seed {seed}: {solution.value / known:.4f} of the best cost")
    assert solution.standard_error < 2e-3 * abs(known)
    assert 1.01 * known < solution.value < known + 4 * solution.standard_error
