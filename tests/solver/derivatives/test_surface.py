"""The surface around a policy, and the margin of its derivatives, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import snapo
from snapo.engine import Xla
from snapo.problem.policy import parameters
from snapo.solver.derivatives.margin import margin_of, with_margin
from snapo.solver.derivatives.surface import coordinates, shifted_policy, surface_of
from snapo.solver.derivatives.verdict import held_alone

ENGINE = Xla("float64")


class Newsvendor(snapo.Simulator):
    """One order for a normal demand; h a unit left, p a unit short."""

    horizon: int = 1
    noise_size: int = 1
    action: snapo.Box = snapo.Box(0.0, 100.0)

    def prepare(self, inputs):
        return snapo.Schedule(dict(inputs), {"t": jnp.zeros(1)})

    def initial(self, constants, noise):
        return jnp.zeros(())

    def observe(self, constants, now, state):
        return jnp.zeros(1)

    def step(self, constants, now, state, action, noise, smooth):
        demand = constants["mean"] + constants["sd"] * noise[0]
        left, short = (smooth.positive_part(s * (action[0] - demand), 10.0) for s in (1, -1))
        return state, {"cash": -(constants["h"] * left + constants["p"] * short)}


AT = {"h": 0.18, "p": 0.7, "mean": 50.0, "sd": 8.0}
FRACTILE = stats.norm.ppf(AT["p"] / (AT["p"] + AT["h"]))
BEST = AT["mean"] + AT["sd"] * FRACTILE


@pytest.fixture(scope="module")
def problem():
    inputs = {name: snapo.Input(value) for name, value in AT.items()}
    return snapo.Problem(Newsvendor(), inputs, snapo.Mean("cash"))


def test_the_surface_has_its_top_and_its_curvature_where_the_value_has():
    """V'' = -(h + p) phi(z) / sd at the best order."""
    inputs = {name: snapo.Input(value) for name, value in AT.items()}
    of = snapo.Problem(Newsvendor(), inputs, snapo.Mean("cash"))
    start = snapo.Constant([BEST - 1.0], of.action)
    around = coordinates(start)
    surface = surface_of(of, around, 16384, 0, ENGINE)
    assert surface is not None
    order = float(parameters(surface.policy)[0])
    curvature = (AT["h"] + AT["p"]) * stats.norm.pdf(FRACTILE) / AT["sd"]
    per_radius = curvature * (surface.radius[0] * (BEST - 1.0)) ** 2
    assert surface.inverse[0, 0] * per_radius == pytest.approx(1.0, rel=0.3)
    # 16,384 paths leave the order to a quarter of a unit or so.
    error = np.sqrt(surface.covariance[0, 0]) * surface.radius[0] * (BEST - 1.0)
    assert abs(order - BEST) < 4 * error and error < 0.6
    assert abs(order - BEST) < 1.0


@pytest.mark.prove
def test_the_interval_of_a_wrong_order_holds_the_derivative_of_the_best_one(problem):
    """Of costs alone held equals the bump of any policy to the last digit: the margin tells."""
    policy = snapo.Constant([BEST - 1.5], problem.action)
    exact = -AT["sd"] * stats.norm.pdf(FRACTILE)  # d/dh, d/dp by the envelope theorem
    slopes = {
        "h": exact - AT["sd"] * FRACTILE * stats.norm.cdf(FRACTILE),
        "p": exact + AT["sd"] * FRACTILE * stats.norm.sf(FRACTILE),
    }
    surface = surface_of(problem, coordinates(policy), 16384, 0, ENGINE)
    assert surface is not None
    table = held_alone(problem, snapo.sensitivities(problem, policy, paths=16384).held)
    margin = margin_of(problem, policy, surface, 4096, 0, ENGINE)
    curvature = (AT["h"] + AT["p"]) * stats.norm.pdf(FRACTILE) / AT["sd"]
    gap = 1.5**2 * curvature / 2
    found = with_margin(problem, policy, table, margin, gap, ENGINE)
    for name, slope in slopes.items():
        alone, wide = table[name].along(np.ones(())), found[name].along(np.ones(()))
        assert not alone.contains(slope) and wide.contains(slope), (name, alone, wide, slope)
        assert wide.high - wide.low < 6 * abs(wide.value - slope) + 0.1


def test_coordinates_of_networks_and_rules():
    interface = snapo.Problem(Newsvendor(), {"h": snapo.Input(1.0)}, snapo.Mean("cash"))
    rule = snapo.Linear([[2.0, -1.0]], offset=[0.5])
    assert np.allclose(coordinates(rule).directions, np.diag([2.0, 1.0, 0.5]))
    del interface
    network = snapo.MLP(snapo.Box(-np.inf, np.inf, 2), 3, key=jnp.zeros(2, jnp.uint32), hidden=(4,))
    around = coordinates(network)
    assert around.directions.shape == (4, parameters(network).size)
    # A shift of the first output moves its bias alone; a gain is its row once more.
    shifted = shifted_policy(network, around.directions[0])
    assert np.allclose(shifted.network.biases[-1] - network.network.biases[-1], [1.0, 0.0])
    gained = shifted_policy(network, around.directions[1])
    assert np.allclose(gained.network.weights[-1][0], 2 * network.network.weights[-1][0])
    assert np.allclose(gained.network.weights[-1][1], network.network.weights[-1][1])
    many = snapo.MLP(snapo.Box(-np.inf, np.inf, 9), 3, key=jnp.zeros(2, jnp.uint32), hidden=(4,))
    assert coordinates(many).directions.shape[0] == 5
    assert coordinates(many, network_like(many)).directions.shape[0] == 6
    recurrent = snapo.GRU(snapo.Box(-np.inf, np.inf), 2, key=jnp.zeros(2, jnp.uint32), hidden=4)
    assert coordinates(recurrent).directions.shape[0] == 2
    assert not np.any(coordinates(recurrent).directions[:, :-7])  # the readout alone


def network_like(policy):
    """The same policy a little elsewhere."""
    return shifted_policy(policy, np.full(parameters(policy).size, 0.01))


class Indifferent(Newsvendor):
    """The same, where no order changes anything."""

    def step(self, constants, now, state, action, noise, smooth):
        return super().step(constants, now, state, 0.0 * action, noise, smooth)


@pytest.mark.prove
def test_where_no_decision_matters_random_directions_end_and_change_nothing():
    """Every length is too short for a loss: the lengths stay finite in float32."""
    inputs = {name: snapo.Input(value) for name, value in AT.items()}
    of = snapo.Problem(Indifferent(), inputs, snapo.Mean("cash"))
    policy = snapo.MLP(hidden=(4,)).for_problem(of.interface, jax.random.key(0))
    surface = surface_of(of, coordinates(policy), 512, 0, ENGINE)
    assert surface is not None
    margin = margin_of(of, policy, surface, 512, 0, ENGINE)
    assert all(len(changes) and not changes.any() for changes in margin.others.values())
