"""The loop: it climbs, stops early, keeps the best, and goes on bit for bit from a checkpoint."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.solver.test_sensitivity import INPUTS, Sale

import snapo
from snapo.engine import Xla
from snapo.problem.policy import parameters
from snapo.solver import checkpoint
from snapo.solver.derivatives import solution_file
from snapo.solver.learning.log import start_notes
from snapo.solver.learning.progress import Interrupted
from snapo.solver.learning.settings import resolve_auto
from snapo.solver.learning.starts import race
from snapo.solver.train import Training, initial_progress, train

SHORT = Training(steps=12, paths=32, validation_paths=64, validation_every=4, warmup=2)


PROBLEM = snapo.Problem(Sale(), INPUTS, snapo.Mean("cash"))


def fresh(training=SHORT):
    policy = snapo.MLP(PROBLEM.action, 2, key=jax.random.key(0), hidden=(4,))
    return initial_progress(policy, training, PROBLEM)


def run(training, progress=None, callbacks=(), problem=PROBLEM):
    return train(problem, progress or fresh(training), training, Xla("float32"), callbacks)


def test_training_climbs_and_keeps_the_best():
    done = run(replace(SHORT, steps=60, learning_rate=0.05))
    assert done.status == "trained"
    assert done.step == 60 == len(done.history)
    exact = [record.exact for record in done.history if np.isfinite(record.exact)]
    # Sold at once the stock fetches 1.5 x 2 = 3; half of it or so stays behind untrained.
    assert done.best_value >= max(exact)
    assert done.best_value > 2.5


def test_a_run_resumed_from_its_checkpoint_ends_with_the_same_bits(tmp_path):
    whole = run(SHORT)
    states = []
    run(SHORT, callbacks=[states.append])
    file = tmp_path / "checkpoint.npz"
    checkpoint.save(states[0], file)
    resumed = checkpoint.load(file, fresh())
    assert resumed.step == 4
    again = run(SHORT, progress=resumed)
    np.testing.assert_array_equal(parameters(again.best), parameters(whole.best))
    np.testing.assert_array_equal(parameters(again.policy), parameters(whole.policy))
    assert [r.objective for r in again.history] == [r.objective for r in whole.history]


def test_a_checkpoint_of_another_policy_or_a_damaged_one_is_refused(tmp_path):
    file = tmp_path / "checkpoint.npz"
    checkpoint.save(run(SHORT), file)
    wider = initial_progress(
        snapo.MLP(PROBLEM.action, 2, key=jax.random.key(0), hidden=(5,)), SHORT
    )
    with pytest.raises(solution_file.CheckpointError, match="another shape"):
        checkpoint.load(file, wider)
    whole = file.read_bytes()
    for damaged in (b"", b"not a checkpoint", whole[: len(whole) // 2]):
        file.write_bytes(damaged)
        with pytest.raises(solution_file.CheckpointError, match="cannot be read"):
            checkpoint.load(file, fresh())


def test_what_is_not_trained_keeps_its_precision(tmp_path):
    third = np.array([1 / 3])
    base = snapo.Constant(jax.numpy.zeros(1))
    base = eqx.tree_at(lambda policy: policy.value, base, third)
    policy = snapo.Residual(base, PROBLEM.action, 2, key=jax.random.key(0), hidden=(4,))
    start = initial_progress(policy, SHORT)
    done = run(SHORT, start)
    checkpoint.save(done, tmp_path / "checkpoint.npz")
    for each in (done, checkpoint.load(tmp_path / "checkpoint.npz", start)):
        assert each.best.base.array.value == third
        assert (parameters(each.best) != parameters(policy)).any()


def test_patience_stops_early():
    done = run(replace(SHORT, steps=400, learning_rate=1e-9, patience=2))
    assert done.status == "stopped early"
    assert done.step < 400


@pytest.mark.prove
def test_windows_and_clips_train_too():
    for training in (replace(SHORT, window=2), replace(SHORT, clip=1.0)):
        done = run(training)
        assert done.status == "trained"
        assert np.isfinite(parameters(done.best)).all()


@pytest.mark.prove
def test_supplied_scenarios_serve_every_role_with_paths_of_its_own():
    numbers = np.arange(3 * 200.0).reshape(3, 200, 1)
    supplied = snapo.Supplied(numbers / 600)
    sources = snapo.Sources.of(supplied, seed=7)
    roles = (sources.training, sources.validation, sources.evaluation)
    used = [set(role.step_noise[0, :, 0]) for role in roles]
    assert [len(each) for each in used] == [120, 40, 40]
    assert not (used[0] & used[1] or used[0] & used[2] or used[1] & used[2])
    problem = replace(PROBLEM, sources=sources)
    assert run(SHORT, problem=problem).status == "trained"
    evaluation = snapo.Evaluation(smooth_paths=0, judge_paths=0)
    solution = snapo.solve(problem, training=SHORT, evaluation=evaluation, engine=Xla())
    assert solution.paths["evaluate"] == 40
    assert set(np.unique(solution.totals["cash"])).isdisjoint({0.0})
    with pytest.raises(ValueError, match="too few"):
        snapo.Sources.of(snapo.Supplied(numbers[:, :100]))
    with pytest.raises(ValueError, match="for evaluation only"):
        run(SHORT, problem=replace(PROBLEM, sources=snapo.Sources(*3 * (snapo.Sobol(),))))


def test_an_interrupt_tells_the_callbacks_and_goes_on():
    seen = []

    def interrupt(progress):
        seen.append(progress.step)
        if len(seen) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(SHORT, callbacks=[interrupt])
    assert seen == [4, 4]


def test_ctrl_c_returns_the_best_policy_so_far():
    seen = []

    def interrupt(progress):
        seen.append(progress)
        if len(seen) == 2:
            raise KeyboardInterrupt

    evaluation = snapo.Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0)
    values = {"evaluation": evaluation, "engine": "native", "callbacks": [interrupt]}
    solution = snapo.solve(PROBLEM, training=SHORT, **values)
    assert solution.status == "interrupted" and np.isfinite(solution.value)
    assert any("interrupted after step" in note for note in solution.notes)
    assert solution.policy is not None and len(solution.history) < SHORT.steps
    seen.clear()
    assert len(snapo.solve_seeds(PROBLEM, seeds=3, training=SHORT, **values).solutions) == 1


@pytest.mark.prove
@pytest.mark.parametrize("starts", [1, 2])
def test_a_callback_that_fails_after_an_interrupt_loses_nothing(starts):
    seen = []

    def write(progress):
        seen.append(progress)
        if len(seen) > 1:
            raise KeyboardInterrupt if len(seen) == 2 else OSError("disk full")

    training = replace(SHORT, starts=starts)
    evaluation = snapo.Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0)
    values = {"evaluation": evaluation, "engine": "xla", "callbacks": [write]}
    solution = snapo.solve(PROBLEM, training=training, **values)
    assert solution.status == "interrupted" and len(seen) == 3
    assert "The callback write failed: OSError: disk full." in solution.notes


def test_ctrl_c_in_a_race_of_starts_leaves_the_best_of_them():
    first = fresh(SHORT)
    started = [replace(first, best_value=value) for value in (1.0, 3.0, 2.0)]

    def stop(progress, until):
        raise Interrupted(progress)

    with pytest.raises(Interrupted) as stopped:
        race(started, SHORT.steps, stop)
    assert stopped.value.result is started[1]


@pytest.mark.prove
def test_a_solution_is_loaded_as_it_was_saved(tmp_path):
    training = replace(SHORT, steps=8)
    evaluation = snapo.Evaluation(paths=256, sensitivity_paths=128, smooth_paths=64)
    solution = snapo.solve(PROBLEM, training=training, evaluation=evaluation, engine="xla")
    solution.save(tmp_path)
    like = snapo.MLP(PROBLEM.action, PROBLEM.features, key=jax.random.key(1))
    again = snapo.Solution.load(tmp_path, like=like)
    assert str(again) == str(solution)
    np.testing.assert_equal(again.history, solution.history)
    for name in ("policy", "halfway"):
        saved, loaded = getattr(solution, name), getattr(again, name)
        np.testing.assert_array_equal(parameters(loaded), parameters(saved))
    np.testing.assert_array_equal(again.totals["cash"], solution.totals["cash"])
    for row, other in zip(solution.sensitivities.rows(), again.sensitivities.rows()):
        np.testing.assert_equal(row, other)
    alone = snapo.Solution.load(tmp_path).policy
    np.testing.assert_array_equal(parameters(alone), parameters(solution.policy))
    (tmp_path / "solution.npz").write_bytes(b"")
    with pytest.raises(solution_file.CheckpointError, match="solution"):
        snapo.Solution.load(tmp_path)


@pytest.mark.prove
def test_an_engine_is_given_by_name_or_as_itself():
    evaluation = snapo.Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0)
    given = {"training": replace(SHORT, steps=2), "evaluation": evaluation}
    named = snapo.solve(PROBLEM, engine="xla", **given)
    itself = snapo.solve(PROBLEM, engine=snapo.Xla(segments=2), **given)
    assert itself.value == pytest.approx(named.value, rel=1e-5)
    assert itself.engine == "xla" and "as requested" in itself.reason
    with pytest.raises(ValueError, match="'fast'; it must be an engine"):
        snapo.solve(PROBLEM, engine="fast", **given)


def test_what_a_problem_has_is_not_given_twice():
    with pytest.raises(ValueError, match="its own inputs"):
        snapo.solve(PROBLEM, INPUTS)


@pytest.mark.prove
def test_halfway_of_a_run_that_stopped_early_is_a_trained_policy():
    """It was the untrained one until half of all the steps asked for were done."""
    wild = replace(SHORT, steps=400, learning_rate=0.5, patience=1)
    done = run(wild)
    assert done.status == "stopped early" and done.step < 200
    for other in (fresh(wild).policy, done.average):
        assert (parameters(done.halfway) != parameters(other)).any()
    states = []
    whole = run(SHORT, callbacks=[states.append])
    middle = run(replace(SHORT, validation_every=6), callbacks=[states.append])
    assert middle.step == whole.step == 12
    assert states[3].step == 6
    np.testing.assert_array_equal(parameters(whole.halfway), parameters(states[3].average))


class Fragile(snapo.Simulator):
    """Wealth after one noisy bet, lost where the noise is below minus `brink`."""

    horizon: int = 1
    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 1
    broken: float = float("nan")

    def prepare(self, inputs):
        return snapo.Schedule(inputs, {"one": np.ones(1)})

    def initial(self, constants, noise):
        return constants["wealth"]

    def observe(self, constants, now, state):
        return state[None]

    def step(self, constants, now, state, action, noise, smooth):
        bet = state * (1 + 0.1 * action[0] * noise[0])
        return bet, {"wealth": jax.numpy.where(noise[0] < -constants["brink"], self.broken, bet)}


def fragile(broken: float, objective: snapo.Objective, brink: float) -> snapo.Problem:
    inputs = {"wealth": snapo.Input(1.0), "brink": snapo.Input(brink)}
    return snapo.Problem(Fragile(broken=broken), inputs, objective)


@pytest.mark.prove
def test_paths_that_are_not_finite_are_counted_in_every_record(tmp_path):
    """About 3e-4 of the paths break below -3.4 deviations; beyond one in a thousand none counts."""
    training = replace(SHORT, paths=256)
    evaluation = snapo.Evaluation(paths=16384, sensitivity_paths=8192, smooth_paths=4096)
    given = {"training": training, "evaluation": evaluation, "engine": "xla"}
    rare = snapo.solve(fragile(float("nan"), snapo.Mean("wealth"), 3.4), **given)
    assert rare.status == "trained" and np.isfinite(rare.value)
    assert rare.value == pytest.approx(1.0, abs=0.01)
    assert 0 < rare.dropped["evaluate"] <= 16 and 0 < rare.dropped["sensitivities"] <= 12
    assert rare.dropped["train"] == sum(record.bad_paths for record in rare.history)
    assert "non-finite" in str(rare) and rare.summary()["dropped"] == dict(rare.dropped)
    # A hundredth of the wealth more is a hundredth of the value more, without the paths left out.
    assert rare.sensitivities.held["wealth"].value == pytest.approx(rare.value, rel=1e-2)
    assert np.isfinite(rare.sensitivities.held["wealth"].standard_error)
    rare.save(tmp_path)
    again = snapo.Solution.load(tmp_path)
    assert again.dropped == rare.dropped and again.notes == rare.notes
    often = snapo.solve(fragile(float("nan"), snapo.Mean("wealth"), 2.0), **given)
    assert often.status == "diverged" and np.isnan(often.value)
    assert often.history and often.dropped["train"] > 0
    assert np.isnan(often.sensitivities.held["wealth"].value)


class Breaks(snapo.Simulator):
    """Breaks in its third step of four: its state, its output, or its derivative alone."""

    horizon: int = 4
    action: snapo.Box = snapo.Box(0.0, 1.0)
    noise_size: int = 1
    kind: str = "state"

    def prepare(self, inputs):
        return snapo.Schedule(inputs, {"day": np.arange(4.0)})

    def initial(self, constants, noise):
        return {"water": constants["water"]}

    def observe(self, constants, now, state):
        return jax.numpy.stack([now["day"] / 4])

    def step(self, constants, now, state, action, noise, smooth):
        third, jnp = now["day"] == 2, jax.numpy
        water = state["water"] + 0.1 * action[0] + 0.01 * noise[0]
        cash = water
        if self.kind == "state":
            water = jnp.where(third, jnp.inf, water)
        elif self.kind == "output":
            cash = jnp.where(third & (noise[0] > 0), jnp.nan, cash)
        else:
            cash = cash + jnp.sqrt(jnp.where(third, 0.0, 1.0) * action[0])
        return {"water": water}, {"cash": cash}


@pytest.mark.prove
@pytest.mark.parametrize(
    "kind, said",
    [
        ("state", "64 of 64 paths are non-finite in output 'cash', first at step 2 of the 4 of a "
         "path, in state water."),
        ("output", "32 of 64 paths are non-finite in output 'cash', first at step 2 of the 4 of a "
         "path, in output cash."),
        ("derivative", "non-finite, although all totals are finite. step, "),
    ],
)  # fmt: skip
def test_a_training_that_breaks_says_where(kind, said):
    training = snapo.Training(steps=10, paths=64, validation_paths=64)
    evaluation = snapo.Evaluation(paths=64, sensitivity_paths=0, smooth_paths=0)
    problem = snapo.Problem(Breaks(kind=kind), {"water": snapo.Input(5.0)}, snapo.Mean("cash"))
    solution = snapo.solve(problem, training=training, evaluation=evaluation, engine="xla")
    assert solution.status == "diverged" and len(solution.history) == 1
    assert solution.dropped["train"] >= 32
    (note,) = [each for each in solution.notes if "Training stopped" in each]
    assert note.startswith("Training stopped at step 1 of 10: ") and said in note
    assert "snapo.check" in note


class Brittle(Breaks):
    """Earns what is decided, and breaks where that is more than six tenths."""

    def step(self, constants, now, state, action, noise, smooth):
        water = state["water"] + 0.01 * noise[0]
        return {"water": water}, {"cash": jax.numpy.where(action[0] > 0.6, -np.inf, action[0])}


@pytest.mark.prove
def test_a_training_that_breaks_late_is_not_said_to_be_converged():
    training = snapo.Training(steps=400, paths=64, validation_paths=64, learning_rate=0.03)
    evaluation = snapo.Evaluation(paths=64, sensitivity_paths=64, smooth_paths=0, judge_paths=0)
    problem = snapo.Problem(Brittle(), {"water": snapo.Input(5.0)}, snapo.Mean("cash"))
    solution = snapo.solve(problem, training=training, evaluation=evaluation, engine="xla")
    assert solution.status == "diverged" and len(solution.history) > 1
    assert np.isfinite(solution.value) and not solution.convergence
    (note,) = [each for each in solution.notes if "Training stopped" in each]
    assert "a smaller learning_rate than 0.03" in note


class Edge(Brittle):
    """Best just below where it breaks: momentum leads over the edge."""

    def step(self, constants, now, state, action, noise, smooth):
        state, outputs = super().step(constants, now, state, action, noise, smooth)
        return state, {"cash": outputs["cash"] - action[0] - (action[0] - 0.58) ** 2}


@pytest.mark.prove
def test_a_rate_that_nobody_gave_is_lowered_where_it_breaks_the_training(tmp_path):
    problem = snapo.Problem(Edge(), {"water": snapo.Input(5.0)}, snapo.Mean("cash"))
    few = {"paths": 64, "validation_paths": 64, "validation_every": 20, "seed": 1}
    policy, engine = snapo.MLP().for_problem(problem.interface, jax.random.key(0)), Xla()
    training = resolve_auto(snapo.Training(steps=200, **few), problem, policy)
    whole = train(problem, initial_progress(policy, training, problem), training, engine)
    assert whole.status == "trained" and whole.best_value > -0.01  # from 10 x -.08^2
    assert whole.slowed and whole.rate(training) == 0.01 * 0.25 ** len(whole.slowed)
    steps = [record.step for record in whole.history]
    assert steps == list(range(1, 201))
    # A run that stops in between goes on with the lower rate, bit for bit.
    half = train(problem, initial_progress(policy, training, problem), training, engine, until=100)
    checkpoint.save(half, tmp_path / "half.npz")
    again = checkpoint.load(tmp_path / "half.npz", initial_progress(policy, training, problem))
    again = train(problem, again, training, engine)
    assert again.slowed == whole.slowed
    assert eqx.tree_equal(again.policy, whole.policy)
    (told,) = start_notes(whole)
    assert f"step {whole.slowed[0]}" in told or f"steps {whole.slowed[0]}" in told
    given = resolve_auto(snapo.Training(steps=200, learning_rate=0.01, **few), problem, policy)
    broken = train(problem, initial_progress(policy, given, problem), given, engine)
    assert broken.status == "diverged" and not broken.slowed


@pytest.mark.prove
def test_ruin_is_an_outcome_with_the_worst_utility():
    """Under a logarithm a path without wealth counts, in training and in the value."""
    evaluation = snapo.Evaluation(4096, sensitivity_paths=1024, smooth_paths=0, judge_paths=0)
    utility = snapo.ExpectedUtility("wealth", snapo.CRRA(1.0))
    given = {"training": replace(SHORT, paths=256), "evaluation": evaluation, "engine": "xla"}
    ruined = snapo.solve(fragile(-0.5, utility, 2.5), **given)
    assert ruined.status == "ruined" and ruined.value == -np.inf
    assert sum(ruined.dropped.values()) == 0
    assert any("ruin" in note for note in ruined.notes)
    assert any(record.objective == -np.inf for record in ruined.history)
    assert all(np.isfinite(record.gradient_norm) for record in ruined.history)
    assert np.isnan(ruined.sensitivities.held["wealth"].value)
