"""The crystals in a crystalliser: by moments, or by finite volumes over their size.

The moments 0 to 5 are exact where growth does not depend on size: mu_0' = B, and mu_k' = k G
mu_(k-1) + B L0^k, per m3 of slurry. Crystals that dissolve shrink, but none disappears; only finite
volumes can describe that. All crystals grow and shrink by the same length l(t), so a crystal of
size L at a time s has the size L + l(t) - l(s) at a later time t. If this is below 0, the crystal
has dissolved; in the moments it remains with a negative size, and grows again with the others.

Finite volumes solve the population balance n_t + (G n)_L = 0 with births B at the smallest size and
n(L, t) crystals per m3 and m. The state is the number of crystals in each cell of a fixed grid;
between cells they pass at the rate n G. Here n is the density on the upstream side, from slopes
with a limiter: the method is of second order where n is smooth, and makes (almost) no new extremes
where it is not. Crystals that dissolve shrink, and vanish below the smallest size. No crystal grows
out of the largest cell; crystals that accumulate there are reported, because the grid is then too
short. For the moments, n is constant within a cell. The solute follows from the third moment of the
cells, so mass is conserved on any grid.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float, jax, jnp

from ...flowsheet.stream import MOMENTS
from ...given import fixed
from .kinetics import Rates

# Sizes are counted in units of SIZE m and crystals in NUMBER per m3, so that both are of order one.
SIZE, NUMBER = 1e-4, 1e10
UNITS = NUMBER * SIZE ** np.arange(MOMENTS)


class Population(NamedTuple):
    """Crystals per initial volume, as a state of m numbers in SIZE and NUMBER.

    - `start`: [m] the initial state; `seed`: the scaled mu3 of the seed that was added.
    - `moments`: the scaled moments 0 to 5 of all crystals, as a function of the state.
    - `slope`: the change of the state per s, [m], as a function of the state, growth in SIZE/s and
      births in NUMBER/m3/s.
    - `numbers`: the crystals in each cell, in NUMBER, as a function of the state; [0] if they are
      not counted.
    - `states`, `measures`: further numbers on the sizes, over time and at the end, in the domain's
      units, as functions of the state.
    """

    start: Float[Array, " m"]
    seed: Float[Array, ""]
    moments: Callable[[Array], Array]
    slope: Callable[[Array, Array, Array], Array]
    numbers: Callable[[Array], Array]
    states: Callable[[Array], dict[str, Array]]
    measures: Callable[[Array], dict[str, Array]]


def mean_sizes(moments: Float[Array, "... 6"]) -> dict[str, Array]:
    """d32 = mu3 / mu2 and d43 = mu4 / mu3 in m; 0 without crystals."""
    table = {}
    for name, upper in (("d32", 3), ("d43", 4)):
        above, below = moments[..., upper], moments[..., upper - 1]
        empty = below <= 0
        table[name] = jnp.where(empty, 0.0, above / jnp.where(empty, 1.0, below))
    return table


def cell_powers(edges: np.ndarray) -> Float[np.ndarray, "6 N"]:
    """The mean of L^k over each cell, k = 0 to 5."""
    k = np.arange(1, MOMENTS + 1)[:, None]
    return np.diff(edges**k, axis=1) / (k * np.diff(edges))


def by_moments(
    shape: Array,
    nuclei_size: Array | None,
    separate: bool,
    seed: Float[Array, " 6"],
    fed: Float[Array, " 6"],
) -> Population:
    """The population by moments. `seed` and the `fed` crystals are moments in m^k/m3; `nuclei_size`
    is in m, None if it is 0. The state has the scaled moments of all crystals, or with `separate`
    the moments of seed and feed, then those of nuclei. `shape`: kv."""
    units = fixed(UNITS)

    def grow(moments, growth, source) -> list[Array]:
        slope = [jnp.zeros(()) if source is None else source]
        for k in range(1, MOMENTS):
            change = k * growth * moments[k - 1]
            if source is not None and nuclei_size is not None:
                change = change + source * (nuclei_size / SIZE) ** k
            slope.append(change)
        return slope

    def slope(y, growth, born):
        result = grow(y[:MOMENTS], growth, None if separate else born)
        if separate:
            result += grow(y[MOMENTS:], growth, born)
        return jnp.stack(result)

    def measures(y):
        if not separate:
            return {}
        volume = shape * units[3]
        return {"seed_volume": volume * y[3], "nuclei_volume": volume * y[MOMENTS + 3]}

    start = (seed + fed) / units
    return Population(
        start=jnp.concatenate([start, jnp.zeros(MOMENTS)]) if separate else start,
        seed=seed[3] / units[3],
        moments=lambda y: y[:MOMENTS] + y[MOMENTS:] if separate else y,
        slope=slope,
        numbers=lambda y: jnp.zeros(0),
        states=lambda y: {},
        measures=measures,
    )


SHARES = {"d10": 0.1, "d50": 0.5, "d90": 0.9}
QUANTILES = dict.fromkeys(SHARES, "m")  # by volume


def size_states(volume: Float[Array, " N"], edges: np.ndarray) -> dict[str, Array]:
    """d10, d50 and d90 in m, of crystals with this volume in each cell; `edges` in `SIZE`."""
    result = quantiles(volume, edges, tuple(SHARES.values()))
    return {name: SIZE * size for name, size in zip(SHARES, result)}


def size_measures(volume: Float[Array, " N"], edges: np.ndarray) -> dict[str, Array]:
    """d10, d50, d90, the span (d90 - d10) / d50, and the share of the volume in the largest
    cell."""
    result, total = size_states(volume, edges), jnp.sum(volume)
    empty = total <= 0
    wide = result["d90"] - result["d10"]
    result["span"] = jnp.where(empty, 0.0, wide / jnp.where(empty, 1.0, result["d50"]))
    result["at_largest"] = jnp.where(empty, 0.0, volume[-1] / jnp.where(empty, 1.0, total))
    return result


def quantiles(
    volume: Float[Array, " N"], edges: np.ndarray, shares: tuple[float, ...]
) -> Float[Array, " S"]:
    """The sizes below which the crystals have these shares of the volume; 0 without crystals.

    Between edges the volume rises along the monotone cubic of Fritsch and Carlson (1980), so
    that a quantile's derivative does not jump where it passes an edge.
    """
    total = jnp.sum(volume)
    empty = total <= 0
    share = jnp.concatenate([jnp.zeros(1), jnp.cumsum(volume)]) / jnp.where(empty, 1.0, total)
    width, grid = fixed(np.diff(edges)), fixed(edges)
    secant = jnp.diff(share) / width
    left, right = secant[:-1], secant[1:]
    both = left * right > jnp.finfo(left.dtype).tiny ** 0.25
    mean = jnp.where(both, 2 * left * right / jnp.where(both, left + right, 1.0), 0.0)
    slope = jnp.pad(mean, 1)
    inverses = []
    for requested in shares:
        cell = jnp.clip(jnp.sum(share <= requested) - 1, 0, len(edges) - 2)
        h = width[cell]
        endpoints = share[cell], share[cell + 1], h * slope[cell], h * slope[cell + 1]
        inverses.append(grid[cell] + h * _inverse(endpoints, requested))
    return jnp.where(empty, 0.0, jnp.stack(inverses))


def _inverse(endpoints, requested: float) -> Float[Array, ""]:
    """The point in 0 to 1 at which a rising cubic has the value `requested`; `ends`: its values and
    slopes.

    By bisection without derivatives, then two Newton steps, which carry them.
    """

    def cubic(s, bounds):
        low, high, first, last = bounds
        rise = s * s * (3 - 2 * s)
        bend = s * (1 - s) * ((1 - s) * first - s * last)
        return low + (high - low) * rise + bend

    still = jax.lax.stop_gradient(endpoints)
    below, above = jnp.zeros_like(still[0]), jnp.ones_like(still[0])
    for _ in range(24):
        middle = (below + above) / 2
        under = cubic(middle, still) < requested
        below, above = jnp.where(under, middle, below), jnp.where(under, above, middle)
    s = jax.lax.stop_gradient((below + above) / 2)
    for _ in range(2):
        gap, slope = jax.jvp(lambda s: cubic(s, endpoints), (s,), (jnp.ones_like(s),))
        s = s - (gap - requested) / jnp.where(slope > 0, slope, 1.0)
    return s


FLAT = 1e-16  # square of a gain so small that it counts as none; without it 0/0 in empty cells
NEGATIVE = 0.05  # of the largest density: so far below zero a time step was unstable


def by_finite_volumes(
    edges: np.ndarray, seed: Float[Array, " N"], fed: Float[Array, " N"] | None = None
) -> Population:
    """The population by finite volumes. The state: crystals in each cell, NUMBER per m3. `edges`:
    [N + 1] m; `seed`, `fed`: the crystals of seed and feed at the start."""
    edges = edges / SIZE
    powers = fixed(cell_powers(edges))
    width = fixed(np.diff(edges))

    def slope(y, growth, born):
        n = y / width
        # The limiter bounds waves that grow by too long a time step: they stay about zero.
        n = jnp.where(jnp.min(n) > -NEGATIVE * jnp.max(n), n, jnp.nan)
        step = limited_steps(n, edges) / 2
        larger = jnp.where(growth > 0, growth, 0.0)
        smaller = growth - larger
        between = larger * (n + step)[:-1] + smaller * (n - step)[1:]
        first = born + smaller * n[0]
        flux = jnp.concatenate([first[None], between, jnp.zeros(1)])
        return flux[:-1] - flux[1:]

    return Population(
        start=seed if fed is None else seed + fed,
        seed=(powers @ seed)[3],
        moments=lambda y: powers @ y,
        slope=slope,
        numbers=lambda y: y,
        states=lambda y: size_states(y * powers[3], edges),
        measures=lambda y: size_measures(y * powers[3], edges),
    )


def limited_steps(n: Float[Array, " N"], edges: np.ndarray) -> Float[Array, " N"]:
    """The gain of a density across each cell, limited; 0 in the first and in the last cell.

    If F is the gain by the forward difference and B by the backward difference, it is F B (F + B) /
    (F^2 + B^2), the limiter of van Albada, van Leer and Roberts (Astronomy and Astrophysics 108,
    1982). It equals F if F = B. Its size is at most 1.21 times the smaller of F and B if they have
    the same sign, and a fifth of it if not. The limiter of van Leer has a kink where F or B changes
    its sign: with it, central differences over 0.02 K of a cooling crystalliser were 0.7 % off its
    derivative, and with this limiter 0.004 %.
    """
    centre, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    difference, inner = jnp.diff(n) / fixed(np.diff(centre)), fixed(width[1:-1])
    forward, backward = inner * difference[1:], inner * difference[:-1]
    f, b = forward**2 + FLAT, backward**2 + FLAT
    return jnp.pad((forward * b + backward * f) / (f + b), 1)


SURFACE = 0.01  # of all crystals' surface that may belong to some which are gone
MAXIMUM = 1000  # points in time
REMEDY = 'the method "moments" lets no crystal disappear; use method = "finite-volumes"'


def disappeared(track: dict[str, np.ndarray], rates: Rates, nuclei_size: float) -> str:
    """A sentence on crystals that would dissolve completely along a `track` of moments with its
    `rates`; "" if few would. The smallest crystals at the start are those at the 2 % quantile of a
    lognormal distribution with the track's first moments.
    """
    time, growth = track["time"], np.asarray(rates.growth)
    born = np.append(0.0, _steps(np.asarray(rates.nucleation), time))
    length = np.append(0.0, np.cumsum(_steps(growth, time)))
    smallest, shrunk = _smallest(*(track[f"mu{k}"][0] for k in range(3))), -length.min()
    if 0 < smallest <= shrunk:
        return (
            f"crystals shrink by {1e6 * shrunk:.3g} um, but the smallest ones at the start have a "
            f"size of {1e6 * smallest:.3g} um: {REMEDY}"
        )
    # Nuclei of an interval count as born at its end.
    selected = np.unique(np.linspace(0, len(time) - 1, MAXIMUM).astype(int))
    born = np.diff(np.cumsum(born)[selected], prepend=0.0)
    size = (
        nuclei_size + length[selected][:, None] - length[selected]
    )  # of those born then, at every time
    gone = np.minimum.accumulate(np.tril(size) + np.triu(np.full_like(size, np.inf), 1), 0) < 0
    surface = np.where(gone, size**2, 0.0) @ born
    complete = track["mu2"][selected]
    share = np.max(surface / np.where(complete > 0, complete, np.inf))
    if share > SURFACE:
        return (
            f"crystals that should have dissolved completely have {share:.2g} of the surface: "
            f"{REMEDY}"
        )
    return ""


def _steps(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.diff(time) * (rate[1:] + rate[:-1]) / 2


def _smallest(mu0: float, mu1: float, mu2: float) -> float:
    """exp(m - 2 s) of a lognormal distribution with these moments; 0 without crystals."""
    if mu0 <= 0 or mu1 <= 0:
        return 0.0
    spread = np.sqrt(np.log(max(mu2 * mu0 / mu1**2, 1.0)))
    return float(mu1 / mu0 * np.exp(-(spread**2) / 2 - 2 * spread))
