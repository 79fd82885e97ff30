"""The flagship process chain in CasADi with CVODES, for comparison in `benchmarks.pharma`.

The equations are the same, written for CasADi as a user would write them for speed: scaled states,
and the fast symbols (SX) in the right-hand sides, which are compiled if there is a C compiler.
Kinks, at the nodes of the temperature profile and where supersaturation crosses zero, are left to
the error control of CVODES (an integrator for each piece of the profile took as long).
"""

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

POINT = np.array([313.15, 308.0, 295.0, 278.15, 2.0, 323.15])  # T_R, T1, T2, T_f, W, T_d
GAS, SHAPE, DENSITY = 8.314, 0.5236, 1200.0
START, CHARGE, VOLUME, LOADING = 313.15, 0.33, 0.06, 0.02
SIZE, NUMBER = 1e-4, 1e10  # units of the scaled moments
UNITS = NUMBER * SIZE ** np.arange(6)


class Settings(NamedTuple):
    """Settings of CVODES. `tolerance`: relative and absolute (states are scaled); `jit`: whether
    right-hand sides are compiled by the machine's C compiler."""

    tolerance: float
    jit: bool = False

    def options(self) -> dict:
        found = {"reltol": self.tolerance, "abstol": self.tolerance, "max_num_steps": 100_000}
        # Adams is two to four times as accurate here as BDF in the same time. Without error
        # control of quadratures adjoints are several times less accurate.
        found |= {"linear_multistep_method": "adams", "quad_err_con": True}
        if self.jit:
            flags = {"flags": ["-O3"], "compiler": "cc"}
            found |= {"jit": True, "compiler": "shell", "jit_options": flags}
        return found


def _reactor(settings: Settings) -> Callable:
    """Extents of both reactions after the batch, from the temperature of the reactor."""
    x, warm = ca.SX.sym("x", 2), ca.SX.sym("T")
    k1 = 2.654e4 * ca.exp(-4.0e4 / (GAS * warm))
    k2 = 5.3e2 * ca.exp(-3.0e4 / (GAS * warm))
    a, b, c = CHARGE - x[0] - x[1], CHARGE - x[0], x[0] - x[1]
    dae = {"x": x, "p": warm, "ode": 3600 * ca.vertcat(k1 * a * b, k2 * a * c)}
    run = ca.integrator("reactor", "cvodes", dae, 0, 1, settings.options())
    return lambda temperature: run(x0=np.zeros(2), p=temperature)["xf"]


def _crystals(settings: Settings) -> Callable:
    """Scaled moments at the end, from the moments and the solute (kg/m3) at the start, and the
    temperatures at the four nodes of the profile."""
    t, y, solute, nodes = (
        ca.SX.sym(name, n) for name, n in (("t", 1), ("y", 6), ("c", 1), ("T", 4))
    )
    rise = nodes[1:] - nodes[:3]
    warm = nodes[0] + sum(rise[k] * ca.fmin(ca.fmax(t - k, 0), 1) for k in range(3))
    saturated = 226.9 - 1.88 * warm + 3.89e-3 * warm**2
    mu3 = y[3] * UNITS[3]
    s = (solute + LOADING - DENSITY * SHAPE * mu3 - saturated) / saturated
    root = ca.sqrt(s * s + 1e-10)
    plus = ca.if_else(s > 0, (s + root) / 2, 5e-11 / (root - s))
    growth = 5e-6 * plus**1.32 / SIZE
    born = (3e8 * plus**3 + 4.46e10 * plus**2 * (SHAPE * mu3) ** 1e-5) / NUMBER
    slope = ca.vertcat(born, *(k * growth * y[k - 1] for k in range(1, 6)))
    dae = {"t": t, "x": y, "p": ca.vertcat(solute, nodes), "ode": 2400 * slope}
    run = ca.integrator("crystals", "cvodes", dae, 0, 3, settings.options())
    return lambda y, solute, nodes: run(x0=y, p=ca.vertcat(solute, nodes))["xf"]


def chain(settings: Settings) -> ca.Function:
    """[6] parameters to [6] attributes, in the order and units of the case."""
    p = ca.MX.sym("p", 6)
    reacted, wash, dry = _reactor(settings)(p[0]), p[4], p[5]
    solute, side = 150 * (reacted[0] - reacted[1]), reacted[1]
    number = LOADING / (DENSITY * SHAPE * 20e-6**3)
    nodes, seed = ca.vertcat(START, p[1:4]), number * 20e-6 ** np.arange(6) / UNITS
    y = _crystals(settings)(seed, solute, nodes)
    mu = [y[k] * UNITS[k] for k in range(6)]
    d32, d43, solid = mu[3] / mu[2], mu[4] / mu[3], DENSITY * SHAPE * mu[3]
    porosity, share = 0.4, solid / DENSITY
    filtrate = VOLUME * (1 - share) - VOLUME * share * porosity / (1 - porosity)
    resistance = 180 * (1 - porosity) / (porosity**3 * d32**2 * DENSITY)
    flux = filtrate / 0.02
    per_area = resistance * solid * VOLUME / filtrate
    time = 4.6e-4 / 1e5 * (per_area / 2 * flux**2 + 1e10 * flux)
    liquor = 0.2 * porosity / ((1 - porosity) * DENSITY)
    rate = 1e-3 * ca.exp(-4e4 / GAS * (1 / dry - 1 / 323.15)) * 40e-6 / d32
    radius_left = 1 - 7e-10 * 0.5 * 1800 / (DENSITY * 30e-6 * d32 / 2)
    found = ca.vertcat(
        100 * (solid - LOADING) / (CHARGE * 150),
        1e6 * d43,
        100 * liquor * 250 * side * ca.exp(-0.9 * wash),
        1e6 * 887.6 * liquor * ca.exp(-rate * 10800),
        100 * (1 - radius_left**3),
        time,
    )
    return ca.Function("chain", [p], [found])


def adjoint(settings: Settings, rows: list[int], columns: list[int], at_once: bool) -> Callable:
    """[rows, columns] derivatives and the values. Each row takes one adjoint pass with its forward
    run; `at_once`: one forward run, and all adjoint passes together."""
    run = chain(settings)
    count = len(rows) if at_once else 1
    back, seeds = run.reverse(count), np.eye(6)[rows]

    def call(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, moved = None, []
        for seed in [seeds.T] if at_once else [each[:, None] for each in seeds]:
            found = run(point)
            moved.append(np.array(back(point, found, seed)).T)
        return np.array(found).ravel()[rows], np.concatenate(moved)[:, columns]

    return call


def forward(settings: Settings, rows: list[int], columns: list[int]) -> Callable:
    """The same by forward sensitivities, all directions together."""
    run = chain(settings)
    push, seeds = run.forward(len(columns)), np.eye(6)[:, columns]

    def call(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = run(point)
        return np.array(found).ravel()[rows], np.array(push(point, found, seeds))[rows]

    return call


def differences(tolerance: float = 1e-12) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives at `POINT` without automatic differentiation: fourth-order central
    differences of runs with a tight tolerance."""
    run, columns = chain(Settings(tolerance)), []
    for k, step in enumerate([0.1, 0.1, 0.1, 0.1, 0.02, 0.1]):
        moves = step * np.eye(6)[k]
        found = [np.array(run(POINT + n * moves)).ravel() for n in (-2, -1, 1, 2)]
        columns.append((found[0] - 8 * found[1] + 8 * found[2] - found[3]) / (12 * step))
    return np.array(run(POINT)).ravel(), np.array(columns).T
