"""Numbers that are possible and yet not likely, or not possible together: noted, or refused."""

from collections.abc import Iterable, Sequence
from dataclasses import fields

import numpy as np

from snapo.case.error import CaseError
from snapo.case.plausible import CaseFiles, CheckedNumbers, Plausible, checked_numbers, implausible
from snapo.case.quantity import numbers_in

from ...flowsheet.feed import Feed
from ...flowsheet.network import FlowNetwork
from ...time.profile import Profile
from ...units.crystals.seed import Seed
from ...units.crystals.solubility import Solubility, nominal_solubility
from ...units.operation import Unit
from ..entries import EntryNumbers
from ..numbers import LIQUID

RANGES = (
    Plausible(200.0, 500.0, "processes in liquids mostly run from 200 to 500 K", unit="K"),
    Plausible(800.0, 5000.0, "crystals mostly have 800 to 5000 kg/m^3", unit="kg/m3",
              endings=(".density",)),
    Plausible(0.25, 0.75, "cakes mostly have 0.25 to 0.75", unit="1", endings=(".porosity",)),
    Plausible(0.01, 1.5, "a sphere has 0.52 and a cube 1", unit="1", endings=(".shape",)),
    Plausible(1.0, 6.048e5, "units mostly run from seconds to a week; is it in hours or minutes?",
              unit="s", endings=(".duration", ".time")),
    Plausible(1e-9, 0.01, "crystals and films mostly have nanometres to millimetres", unit="m",
              endings=(".size", "_size", ".film")),
    Plausible(1e3, 1e6, "energies of activation and heats mostly are 1 to 1,000 kJ/mol",
              unit="J/mol", by_size=True),
    Plausible(1e-9, 60.0, "water itself is 55 mol/L", unit="kmol/m3"),
    Plausible(1.0, 1e9, "100,000 Pa are 1 bar", unit="Pa"),
    Plausible(1e-6, 1e3, "water has 0.001 Pa*s", unit="Pa*s"),
    Plausible(1e-14, 1e-3, "in liquids it mostly is about 1e-9 m^2/s", unit="m2/s"),
    Plausible(1e-9, 1e4, "1 L is 0.001 m3", unit="m3"),
    Plausible(1e-12, 1e-3, "1 um/s is 1e-6 m/s", unit="m/s"),
    Plausible(1.0, 1e6, "a molar mass is in g/mol: water has 18", unit="g/mol"),
)  # fmt: skip
PACKED = 0.5  # of the volume: a slurry with more seed than this does not move
POINTS = 65  # between the lowest and the highest temperature


def check_physics(file, feeds: Sequence[Feed], units: Sequence[Unit], network: FlowNetwork) -> None:
    """Refuses impossible values, with their limit."""
    for feed in feeds:
        _check_feed(file, feed, network)
    for unit in units:
        for part in (getattr(unit, field.name) for field in fields(unit)):
            if isinstance(part, Solubility):
                _check_solubility(file, unit, part)
            if isinstance(part, Seed):
                _check_seed(file, unit, part)


def check_moved_solubility(
    units: Sequence[Unit], spans: Iterable, numbers: EntryNumbers
) -> list[str]:
    """Notes where a solubility falls to 0 within the temperatures that are studied or decided.

    `spans`: (name of a number, its lowest and highest value).
    """
    messages = []
    for name, low, high in spans:
        unit = next((item for item in units if name == f"{item.name}.temperature"), None)
        part = None if unit is None else getattr(unit, "solubility", None)
        if isinstance(part, Solubility):
            at = np.linspace(low, high, POINTS)
            value = nominal_solubility(part, at)
            if (value <= 0).any():
                worst = int(np.argmin(value))
                messages.append(
                    f"{numbers.givens[name].name} may reach {at[worst]:.6g} K, where the "
                    f"solubility is {value[worst]:.4g} kg/m3, which is impossible."
                )
    return messages


def unusual(
    files: CaseFiles, feeds: Sequence[Feed], units: Sequence[Unit], network: FlowNetwork
) -> Iterable[str]:
    """Notes on numbers that are possible and likely to be in another unit."""
    masses = (
        CheckedNumbers(f"species.{name}.molar_mass", np.array([mass]), ("",), "g/mol")
        for name, mass in zip(network.species, network.molar_mass)
    )
    entries = [checked_numbers(entry) for entry in numbers_in((network, feeds, units))]
    # A unit such as degC has an offset as well as a factor.
    entries = [
        entry._replace(display_unit="", display_factor=1.0) if entry.unit == "K" else entry
        for entry in entries
    ]
    return implausible([*entries, *masses], RANGES, files).values()


def _check_feed(file, feed: Feed, network: FlowNetwork) -> None:
    dissolved = float(network.molar_mass @ feed.concentration.values)
    total = dissolved + float(feed.solvent.values[0])
    if total > LIQUID.high:
        message = (
            f"solvent and dissolved species weigh {total:.6g} kg in a cubic metre, and at most "
            f"{LIQUID.high:g} are allowed"
        )
        raise CaseError(str(file), f"feeds.{feed.name}", None, message)


def _check_solubility(file, unit: Unit, part: Solubility) -> None:
    value = getattr(unit, "temperature")  # noqa: B009
    nodes = (value.value if isinstance(value, Profile) else value).values
    at = np.linspace(nodes.min(), nodes.max(), POINTS)
    result = nominal_solubility(part, at)
    worst = int(np.argmin(result))
    if not result[worst] > 0:
        message = (
            f"at {at[worst]:.6g} K, which {unit.name} reaches, it is {result[worst]:.4g} kg/m3; "
            "allowed is above 0"
        )
        raise CaseError(str(file), f"units.{unit.name}.solubility", None, message)


def _check_seed(file, unit: Unit, seed: Seed) -> None:
    density, shape = (float(getattr(unit, key).values[0]) for key in ("density", "shape"))
    if seed.loading is not None:
        share = float(seed.loading.values[0]) / density
    elif seed.moments is not None:
        share = shape * float(seed.moments.values[3])
    else:
        return
    if share >= PACKED:
        message = (
            f"the seed takes {100 * share:.4g} % of the volume; allowed is less than "
            f"{100 * PACKED:g} %"
        )
        raise CaseError(str(file), f"units.{unit.name}.seed", None, message)
