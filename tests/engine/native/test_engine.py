"""The native engine against the XLA engine: everything that the interface offers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from tests.engine.native.problems import TOLERANCE, Store, Tanh, Wide, difference

from snapo.engine import Clip, Window, Xla
from snapo.engine.native import Native, runtime
from snapo.engine.native.runtime import Runner
from snapo.lanes.machine.pipeline import host
from snapo.problem.noise import Stored
from snapo.problem.scenarios import Pseudo, Supplied
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import Exact, Smooth

PATHS = 37
PRECISIONS = ("float32", "float64")


@pytest.fixture(scope="module")
def store():
    simulator = Store()
    return simulator, Tanh((4, 14, 2)), simulator.prepare(None)


def weights(paths: int) -> dict:
    w = np.linspace(-1, 1, paths)
    return {"cash": w, "peak": w**2, "left": np.ones(paths), "end": np.cos(w)}


def draws(simulator, paths=PATHS, antithetic=True):
    return Pseudo(7, antithetic).draws(np.arange(paths), simulator)


@pytest.mark.parametrize(
    ("precision", "smooth"),
    [
        pytest.param("float32", Smooth(0.3), id="float32-smooth"),
        pytest.param("float64", Exact(), id="float64-exact"),
        pytest.param("float32", Exact(), id="float32-exact", marks=pytest.mark.prove),
        pytest.param("float64", Smooth(0.3), id="float64-smooth", marks=pytest.mark.prove),
    ],
)
def test_values_and_gradients(store, precision, smooth):
    simulator, policy, schedule = store
    noise = draws(simulator)
    record = ("state", "action", "outputs", "slack")
    results = []
    for engine in (Xla(precision), Native(precision)):
        values = engine.values(simulator, policy, schedule, noise, smooth, record=record)
        adjoint = engine.adjoint(simulator, policy, schedule, noise, smooth, weights(PATHS))
        results.append((values, adjoint))
    # Values are compared more loosely in float32: normals agree to 4 units in the last place.
    assert difference(results[0][0], results[1][0]) < TOLERANCE[precision]
    assert difference(results[0][1], results[1][1]) < TOLERANCE[precision]


@pytest.mark.prove
@pytest.mark.parametrize("precision", ["float64", pytest.param("float32", marks=pytest.mark.study)])
def test_windows_starts_actions_and_clipping(store, precision):
    simulator, policy, schedule = store
    noise, smooth = draws(simulator, antithetic=False), Smooth(0.3)
    native, xla = Native(precision), Xla(precision)
    window = Window(2, 4)
    start = {
        "x": np.linspace(-1, 1, PATHS), "level": np.linspace(0.1, 0.9, PATHS), "count": np.arange(PATHS),
    }  # fmt: skip
    keyed = {"window": window, "start": start}
    found = native.values(simulator, policy, schedule, noise, smooth, record=("action",), **keyed)
    expected = xla.values(simulator, policy, schedule, noise, smooth, record=("action",), **keyed)
    assert difference(expected, found) < TOLERANCE[precision]
    actions = np.asarray(expected.record["action"])
    given = {k: w for k, w in weights(PATHS).items() if k != "end"}
    for extra in (
        {"clip": Clip(0.5)},
        {"actions": actions},
        {"actions": actions, "clip": Clip(0.01)},
    ):
        args = (simulator, policy, schedule, noise, smooth, given)
        expected = xla.adjoint(*args, **keyed, **extra)
        found = native.adjoint(*args, **keyed, **extra)
        assert difference(expected, found) < TOLERANCE[precision]


@pytest.mark.prove
def test_many_cotangents_and_a_choice_of_gradients(store):
    simulator, policy, schedule = store
    noise, smooth = draws(simulator), Smooth(0.3)
    rows = {
        "cash": np.stack([np.ones(PATHS), np.linspace(0, 1, PATHS)]),
        "peak": np.ones((2, PATHS)),
    }
    args = (simulator, policy, schedule, noise, smooth, rows)
    assert difference(Xla().adjoint(*args), Native().adjoint(*args)) < 1e-5
    only = Native().adjoint(*args, wrt=("policy",))
    assert only.schedule is None and only.start is None
    assert difference(Xla().adjoint(*args).policy, only.policy) < 1e-5


@pytest.mark.prove
@pytest.mark.parametrize("limit", [None, "TAPE", "SUMS"])
def test_columns_of_weights_share_one_forward_sweep(store, limit, monkeypatch):
    """Bit for bit the gradients of single passes; with a tape in segments, and in several runs."""
    simulator, policy, schedule = store
    noise, smooth, native = draws(simulator), Smooth(0.3), Native("float64")
    columns = {n: np.stack([w, 0 * w, w[::-1]]) for n, w in weights(PATHS).items()}
    args = simulator, policy, schedule, noise, smooth
    alone = [native.adjoint(*args, {n: w[k] for n, w in columns.items()}) for k in range(3)]
    if limit is not None:
        monkeypatch.setattr(runtime, limit, 1)
    again = [native.adjoint(*args, {n: w[k] for n, w in columns.items()}) for k in range(3)]
    runs, ran = [], Runner.run
    monkeypatch.setattr(
        Runner, "run", lambda self, given, threads: runs.append(given) or ran(self, given, threads)
    )
    found = native.adjoint(*args, columns)
    assert len(runs) == (3 if limit == "SUMS" else 1)
    for name in ("policy", "schedule", "start"):
        for k in range(3):
            one = jax.tree.map(lambda x, k=k: x[k], getattr(found, name))
            jax.tree.map(np.testing.assert_array_equal, one, getattr(again[k], name))
            assert difference(getattr(alone[k], name), one) < 1e-13


@pytest.mark.prove
def test_supplied_noise(store):
    simulator, policy, schedule = store
    rng = np.random.default_rng(0)
    noise = Supplied(rng.normal(size=(9, PATHS, 3)), rng.normal(size=(PATHS, 1)))
    table = noise.draws(np.arange(PATHS), simulator)
    args = (simulator, policy, schedule, table, Smooth(0.3), weights(PATHS))
    assert difference(Xla().adjoint(*args), Native().adjoint(*args)) < 1e-5


@pytest.mark.prove
@pytest.mark.parametrize("precision", [pytest.param("float32", marks=pytest.mark.study), "float64"])
def test_wide_states_and_matrices(precision):
    simulator = Wide()
    schedule, policy = simulator.prepare(None), Tanh((25, 20, 1))
    noise = draws(simulator, 21)
    args = (simulator, policy, schedule, noise, Exact())
    native, xla = Native(precision), Xla(precision)
    assert (
        difference(xla.values(*args, record=("state",)), native.values(*args, record=("state",)))
        < TOLERANCE[precision]
    )
    weight = {"value": np.linspace(0, 1, 21)}
    assert (
        difference(xla.adjoint(*args, weight), native.adjoint(*args, weight)) < TOLERANCE[precision]
    )


class Corners(Tanh):
    """Layers with two biases (both have the same gradient), a gate, and a matrix turned over."""

    turned: Array

    def __init__(self, widths):
        super().__init__(widths)
        self.turned = 0.3 * jnp.cos(jnp.arange(float(widths[1] ** 2))).reshape(widths[1], -1)

    def __call__(self, x, smooth):
        first, middle, last = self.weights
        shift, again, end = self.biases
        x = jax.nn.relu(first @ x + shift + jnp.roll(again, 1)[: shift.size])
        plane = jnp.outer(x, x[::-1]).reshape(x.size, -1) * (self.turned @ jnp.outer(x, x)).T
        x = jnp.maximum(middle @ x + again, 0.1 * x[0]) + plane.sum() / x.size**3
        return jax.nn.sigmoid(last @ x + end)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("kind", "precision", "widths"),
    [
        (Tanh, "float64", (4, 12, 13, 2)),
        (Tanh, "float64", (4, 33, 32, 2)),
        (Corners, "float64", (4, 7, 7, 2)),
        pytest.param(Tanh, "float32", (4, 96, 98, 2), marks=pytest.mark.study),
        pytest.param(Corners, "float32", (4, 97, 97, 2), marks=pytest.mark.study),
    ],
)
def test_sizes_that_tiles_do_not_divide(store, kind, precision, widths):
    """Products and their sums go by tiles and panels; what is left over has tiles of its own."""
    simulator, _, schedule = store
    given = (simulator, kind(widths), schedule, draws(simulator, 19), Smooth(0.3), weights(19))
    found = difference(Xla(precision).adjoint(*given), Native(precision).adjoint(*given))
    assert found < TOLERANCE[precision]


def test_nothing_is_compiled_twice(store, monkeypatch):
    simulator, policy, schedule = store
    noise = draws(simulator)
    native = Native()
    native.values(simulator, policy, schedule, noise, Smooth(0.3))
    monkeypatch.setattr("snapo.engine.native.call.linked_code", None)
    native.values(simulator, policy, schedule, noise, Smooth(0.1))
    native.values(simulator, Tanh((4, 14, 2), seed=1), schedule, draws(simulator, 99), Smooth(0.2))


@pytest.mark.prove
def test_gradients_do_not_depend_on_unused_lanes(store):
    """A last block that is not full adds nothing, even where one path is not finite."""
    simulator, policy, schedule = store
    noise, smooth = draws(simulator, 3), Exact()
    start = {"x": np.array([0.1, 0.2, np.inf]), "level": np.full(3, 0.5), "count": np.zeros(3, int)}
    given = {"cash": np.array([1.0, 1.0, 0.0])}
    args = (simulator, policy, schedule, noise, smooth, given)
    expected = Xla().adjoint(*args, window=Window(0, 2), start=start)
    found = Native().adjoint(*args, window=Window(0, 2), start=start)
    assert difference(expected.start, found.start) < 1e-5


def test_results_are_numpy_arrays_of_the_precision(store):
    simulator, policy, schedule = store
    noise = draws(simulator)
    single = Native().values(simulator, policy, schedule, noise, Exact()).totals["cash"]
    double = Native("float64").values(simulator, policy, schedule, noise, Exact()).totals["cash"]
    assert isinstance(single, np.ndarray) and single.dtype == np.float32
    assert isinstance(double, np.ndarray) and double.dtype == np.float64


@pytest.mark.parametrize("paths", [3, host().lanes("float32")])
def test_results_keep_nothing_else_alive(store, paths):
    """Not what the kernel wrote beside them: numbers of one block lie in a row as they are."""
    simulator, policy, schedule = store
    noise = draws(simulator, paths)
    out = Native().adjoint(simulator, policy, schedule, noise, Exact(), weights(paths))
    for array in jax.tree.leaves(out):
        whole = array
        while whole.base is not None:
            whole = whole.base
        assert whole.nbytes <= 2 * array.nbytes


@pytest.mark.parametrize("engine", [Xla(), Native()], ids=["xla", "native"])
def test_noise_of_another_shape_is_refused(store, engine):
    simulator, policy, schedule = store
    steps, size, initial = simulator.horizon, simulator.noise_size, simulator.initial_noise_size
    right = np.zeros((5, initial)), np.zeros((steps, 5, size))
    wrong = [
        (right[0], np.zeros((steps - 1, 5, size))),
        (right[0], np.zeros((steps, 5, size + 1))),
        (np.zeros((4, initial)), right[1]),
        (np.zeros((5, initial + 1)), right[1]),
    ]
    given = simulator, policy, schedule
    engine.values(*given, Stored(*right), Exact())
    for arrays in wrong:
        with pytest.raises(ValueError, match="noise of the draws has shape"):
            engine.values(*given, Stored(*arrays), Exact())


@pytest.mark.parametrize("engine", [Xla(), Native()], ids=["xla", "native"])
def test_a_schedule_of_too_few_steps_is_refused(store, engine):
    simulator, policy, schedule = store
    short = Schedule(schedule.constants, jax.tree.map(lambda leaf: leaf[:1], schedule.steps))
    with pytest.raises(ValueError, match=r"schedule.steps\[.*\] has shape \(1,"):
        engine.values(simulator, policy, short, draws(simulator), Exact())


@pytest.mark.parametrize("engine", [Xla(), Native()], ids=["xla", "native"])
def test_no_paths_are_refused(store, engine):
    simulator, policy, schedule = store
    given = simulator, policy, schedule, draws(simulator, 0, False), Exact()
    with pytest.raises(ValueError, match="no paths"):
        engine.values(*given)
    with pytest.raises(ValueError, match="no paths"):
        engine.adjoint(*given, weights(0))


@pytest.mark.prove
@pytest.mark.parametrize("parts", [(16, 21), (1, 30, 6)])
def test_parts_of_the_paths_have_adjoints_of_their_own(store, parts):
    simulator, policy, schedule = store
    given = simulator, policy, schedule, draws(simulator), Smooth(0.3), weights(PATHS)
    found = Native("float64").adjoints(*given, parts)
    assert difference(Xla("float64").adjoints(*given, parts), found) < TOLERANCE["float64"]
    whole = Native("float64").adjoint(*given)
    summed = jax.tree.map(lambda leaf: leaf.sum(0), (found.policy, found.schedule))
    assert difference((whole.policy, whole.schedule), summed) < TOLERANCE["float64"]
    assert difference(whole.totals, found.totals) == 0
