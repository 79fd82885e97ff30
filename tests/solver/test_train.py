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
from snapo.problem.prepare import prepare
from snapo.solver import checkpoint
from snapo.solver.train import Training, begin, train

SHORT = Training(steps=12, paths=32, validation_paths=64, validation_every=4, warmup=2)


def parts(training=SHORT):
    simulator = Sale()
    policy = snapo.MLP(simulator.action, 2, key=jax.random.key(0), hidden=(4,))
    return simulator, prepare(simulator, INPUTS), begin(policy, training), snapo.Mean("cash")


def run(training, progress=None, callbacks=()):
    simulator, schedule, fresh, objective = parts(training)
    given = (simulator, schedule, progress or fresh, objective, training, Xla("float32"))
    return train(*given, callbacks)


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
    checkpoint.save(states[0], file, {"seed": 0})
    resumed = checkpoint.load(file, parts()[2], {"seed": 0})
    assert resumed.step == 4
    again = run(SHORT, progress=resumed)
    np.testing.assert_array_equal(parameters(again.best), parameters(whole.best))
    np.testing.assert_array_equal(parameters(again.policy), parameters(whole.policy))
    assert [r.objective for r in again.history] == [r.objective for r in whole.history]


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    file = tmp_path / "checkpoint.npz"
    checkpoint.save(run(SHORT), file, {"seed": 0})
    with pytest.raises(checkpoint.CheckpointError, match="seed = 0, and now it is 1"):
        checkpoint.load(file, parts()[2], {"seed": 1})
    file.write_bytes(b"not a checkpoint")
    with pytest.raises(checkpoint.CheckpointError, match="cannot be read"):
        checkpoint.load(file, parts()[2], {"seed": 0})


def test_what_is_not_trained_keeps_its_precision(tmp_path):
    simulator, schedule, _, objective = parts()
    third = np.array([1 / 3])
    base = snapo.Constant(jax.numpy.zeros(1))
    base = eqx.tree_at(lambda policy: policy.value, base, third)
    policy = snapo.Residual(base, simulator.action, 2, key=jax.random.key(0), hidden=(4,))
    fresh = begin(policy, SHORT)
    done = train(simulator, schedule, fresh, objective, SHORT, Xla("float32"))
    checkpoint.save(done, tmp_path / "checkpoint.npz", {})
    for each in (done, checkpoint.load(tmp_path / "checkpoint.npz", fresh, {})):
        assert each.best.base.array.value == third
        assert (parameters(each.best) != parameters(policy)).any()


def test_patience_stops_early():
    done = run(replace(SHORT, steps=400, learning_rate=1e-9, patience=2))
    assert done.status == "stopped early"
    assert done.step < 400


def test_windows_and_clips_train_too():
    for training in (replace(SHORT, window=2), replace(SHORT, clip=1.0)):
        done = run(training)
        assert done.status == "trained"
        assert np.isfinite(parameters(done.best)).all()


def test_training_on_supplied_scenarios_draws_from_them():
    simulator, schedule, fresh, objective = parts()
    supplied = snapo.Supplied(np.random.default_rng(0).normal(size=(3, 50, 1)))
    engine = Xla("float32")
    done = train(simulator, schedule, fresh, objective, SHORT, engine, (), supplied)
    assert done.status == "trained"


def test_an_interrupt_tells_the_callbacks_and_goes_on():
    seen = []

    def interrupt(progress):
        seen.append(progress.step)
        if len(seen) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(SHORT, callbacks=[interrupt])
    assert seen == [4, 4]
