"""The units of operation and feeds of a process as resolved data; conventions as in `records`.

Every `Given` here is named "unit.field" ("reactor.temperature"), the unit being the record's own
`name`; labels say which node, species or coefficient an entry is. Optional parts are None.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from snapo.case.given import Given


@dataclass(frozen=True, eq=False)
class Profile:
    """A control over a unit's time: N nodes, piecewise linear or piecewise constant.

    - `share`: "linear": [N] times of the nodes as shares of the unit's duration, 0 to 1, strictly
      rising from 0 to 1. "constant": [N + 1] edges of the pieces. One constant piece is a number.
    - `value`: index [N], in the quantity's unit.
    - `ramp`: most change per second, None without limit; open loop it is checked and reported.
    """

    kind: Literal["linear", "constant"]
    share: np.ndarray
    value: Given
    ramp: float | None


@dataclass(frozen=True, eq=False)
class Feed:
    """Material that enters: amounts of one batch, or of `duration` seconds of a continuous run.

    - `volume`: m3, index []; `temperature`: K, []; `concentration`: kmol/m3, index [S], labels are
      the species; `solvent`: kg/m3 of solvent per volume fed, [].
    - `duration`: s over which a continuous unit takes it in; None for a batch.
    """

    name: str
    volume: Given
    temperature: Given
    concentration: Given
    solvent: Given
    duration: float | None


@dataclass(frozen=True, eq=False)
class Jacket:
    """Heat balance: rho cp V dT/dt = -sum(H_i r_i) V - UA (T - T_jacket) + inflow's sensible heat.

    - `heat_capacity`: J/m3/K of the mixture, []; `conductance`: UA in W/K, []; for a plug-flow
      reactor of its whole length. `temperature`: of the jacket, a profile in K.
    """

    heat_capacity: Given
    conductance: Given
    temperature: Profile


@dataclass(frozen=True, eq=False)
class Reactor:
    """Reactor of the case's network. Ports: feed (and dose, semi-batch) in; product out.

    - `kind`: "batch"; "semi-batch" (the stream at `dose` enters at `dosing` m3/s; what of the
      stream is not dosed by the end is an error in the case); "stirred" (continuous, `volume` m3);
      "plug-flow" (`cells` in series, upwind; residence time V / flow).
    - `filled`: what a continuous reactor holds at the start, its feed or the feed's solvent alone.
    - `duration`: s, []. Continuous kinds deliver what left the outlet, mixed, over the duration.
    - `temperature`: profile in K; where there is a `jacket`, its first value is where it starts.
    """

    name: str
    kind: Literal["batch", "semi-batch", "stirred", "plug-flow"]
    duration: Given
    temperature: Profile
    volume: Given | None
    dosing: Profile | None
    jacket: Jacket | None
    cells: int
    filled: Literal["feed", "solvent"] = "feed"


@dataclass(frozen=True, eq=False)
class Solubility:
    """c*(T, w) in kg/m3.

    - "polynomial": sum_k a_k t^k; "exponential": exp(sum_k a_k t^k); t is T in K less `zero`
      (273.15 for coefficients in Celsius). `coefficients`: a_k, index [n], labels "t^0", ….
    - `antisolvent`: (b1, b2), index [2] or [0]: ln c* gains b1 w + b2 w^2, w the anti-solvent's
      mass fraction of the solute-free liquid.
    """

    kind: Literal["polynomial", "exponential"]
    coefficients: Given
    zero: float
    antisolvent: Given


@dataclass(frozen=True, eq=False)
class Kinetics:
    """Growth, nucleation and dissolution with S = (c - c*) / c* and its positive part S+.

    S+ = (S + sqrt(S^2 + 4 d^2)) / 2 with d = `rounding` (5e-6 gives S^2 + 1e-10); S- = S+ - S.
    G = growth S+^growth_order - dissolution S-^dissolution_order, m/s.
    B = primary S+^primary_order + secondary S+^secondary_order (kv mu3)^crystal_order, 1/m3/s,
    mu3 in m3/m3 being that of all crystals. Every field is a number, index [].
    """

    growth: Given
    growth_order: Given
    dissolution: Given
    dissolution_order: Given
    primary: Given
    primary_order: Given
    secondary: Given
    secondary_order: Given
    crystal_order: Given
    rounding: float


@dataclass(frozen=True, eq=False)
class Seed:
    """Crystals at the start: `loading` kg/m3, [], of `size` m, []; or `moments`, index [6].

    Of the two, one is given and the other None; moments are m^k/m3, k = 0..5.
    `size` is the mean by number and `spread`, [], the standard deviation as a share of it, of a
    lognormal distribution; None where all are of one size.
    """

    loading: Given | None
    size: Given | None
    moments: Given | None
    spread: Given | None = None


@dataclass(frozen=True, eq=False)
class Crystalliser:
    """Batch crystalliser. Ports: feed in (and antisolvent, dosed at `dosing` m3/s), slurry out.

    - `solute`: species; `initial_concentration`: kg/m3, [], where it replaces the feed's (a
      crystalliser alone); None otherwise.
    - `shape`: kv, []; `density`: of crystals, kg/m3, []; `nuclei_size`: m, [].
    - `separate`: whether seed and nuclei keep moments of their own.
    - `edges`: [N + 1] m of N cells over the crystals' size, where these are followed by finite
      volumes; the feed then brings none. None: by the moments 0 to 5.
    """

    name: str
    solute: str
    duration: Given
    temperature: Profile
    initial_concentration: Given | None
    solubility: Solubility
    kinetics: Kinetics
    shape: Given
    density: Given
    nuclei_size: Given
    seed: Seed
    separate: bool
    dosing: Profile | None
    edges: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Filter:
    """Filter and wash at constant pressure. Ports: slurry in; cake, filtrate, washings out.

    All are numbers, index []: m2, Pa, Pa s, 1/m, "1", "1", "1".

    - `porosity` of the cake; `saturation`: share of its voids that keeps liquor.
    - `wash_ratio`: W, wash liquid per void volume. `wash`: "exponential": exp(-efficiency W) of
      a solute stays; "dispersion": Lapidus-Amundson with the Peclet number `peclet`.
    - `resistance`: specific, m/kg, []; None: from porosity and d32 by Carman and Kozeny.
    """

    name: str
    area: Given
    pressure: Given
    viscosity: Given
    medium_resistance: Given
    porosity: Given
    saturation: Given
    resistance: Given | None
    wash: Literal["exponential", "dispersion"]
    wash_ratio: Given
    efficiency: Given | None
    peclet: Given | None


@dataclass(frozen=True, eq=False)
class Dryer:
    """Dryer by a rate constant. Ports: cake in; product, vapour out.

    Falling rate: X' = -k X, k = rate exp(-activation / R (1/T - 1/reference_temperature))
    (reference_size / d32); X is solvent per crystals, kg/kg. `rate`: 1/s, `reference_size`: m.
    """

    name: str
    duration: Given
    temperature: Profile
    rate: Given
    activation: Given
    reference_temperature: float
    reference_size: Given


@dataclass(frozen=True, eq=False)
class Liquid:
    """The liquid in a cake. ln p = ln(10) (A - B / (C + T)) in Pa with T in K (Antoine).

    `antoine`: (A, B, C), index [3]; `latent_heat`: J/kg; `heat_capacity`: J/kg/K; each index [].
    """

    antoine: Given
    latent_heat: Given
    heat_capacity: Given


@dataclass(frozen=True, eq=False)
class TrayDryer:
    """Dryer on a heated shelf under vacuum, its cake ideally mixed. Ports: cake in; product, vapour
    out. Equations: `tray`.

    - `temperature`: of the shelf, K; `pressure`: above the cake, Pa; profiles.
    - `area`: of the shelf, m2; `heat_transfer`: from shelf to cake, W/m2/K; `mass_transfer`: from
      the crystals' surface, kg/m2/s/Pa; each index [].
    - `critical`: moisture in kg/kg of crystals below which the rate falls; `heat_capacity`: of
      crystals, J/kg/K; each index [].
    """

    name: str
    duration: Given
    temperature: Profile
    pressure: Profile
    area: Given
    heat_transfer: Given
    mass_transfer: Given
    critical: Given
    heat_capacity: Given
    liquid: Liquid


@dataclass(frozen=True, eq=False)
class Dissolution:
    """Dissolution test of the product. Ports: product in; none out. Shrinking spheres of d32.

    Dissolved share at `time` s: 1 - (1 - D Cs t / (rho_s h r))^3, 1 once the sphere is gone; the
    crystals' density comes with the stream. `diffusivity`: m2/s; `solubility`: kg/m3; `film`: m;
    `time`: s; each index [].
    """

    name: str
    diffusivity: Given
    solubility: Given
    film: Given
    time: Given


@dataclass(frozen=True, eq=False)
class Tank:
    """Holds and mixes. Ports: one inlet for each name in `inlets`; product out."""

    name: str
    inlets: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Splitter:
    """Divides a stream. Ports: feed in; one outlet for each of `outlets`, in the shares given.

    `share`: index [n - 1], each 0 to 1, of all outlets but the last, which takes the rest.
    """

    name: str
    outlets: tuple[str, ...]
    share: Given


Timed = Reactor | Crystalliser | TrayDryer  # integrated over time
Unit = Timed | Filter | Dryer | Dissolution | Tank | Splitter
