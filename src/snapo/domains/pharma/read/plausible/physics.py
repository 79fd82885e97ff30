"""Numbers that are possible and yet not likely, or not possible together: noted, or refused."""

from collections.abc import Iterable, Sequence
from dataclasses import fields

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import Given

from ...flowsheet.feed import Feed
from ...flowsheet.network import Network
from ...given import every_given
from ...time.profile import Profile
from ...units.crystals.seed import Seed
from ...units.crystals.solubility import Solubility, nominal_solubility
from ...units.operation import Unit
from ..entries import Numbers
from ..numbers import LIQUID

# (unit, ends of a number's name, least, most, words) beyond which an owner is asked to look again.
USUAL = (
    ("K", ("",), 200.0, 500.0, "processes in liquids mostly run from 200 to 500 K"),
    ("kg/m3", (".density",), 800.0, 5000.0, "crystals mostly have 800 to 5000 kg/m^3"),
    ("1", (".porosity",), 0.25, 0.75, "cakes mostly have 0.25 to 0.75"),
    ("1", (".shape",), 0.01, 1.5, "a sphere has 0.52 and a cube 1"),
)
PACKED = 0.5  # of the volume: a slurry with more seed than this does not move
POINTS = 65  # between the lowest and the highest temperature


def check_physics(
    file, feeds: Sequence[Feed], units: Sequence[Unit], network: Network, notes: list[str]
) -> None:
    """Refuses what cannot be, with its limit; notes what is unusual."""
    for given in every_given((feeds, units)):
        notes += _unusual(given)
    for feed in feeds:
        _check_feed(file, feed, network)
    for unit in units:
        for part in (getattr(unit, field.name) for field in fields(unit)):
            if isinstance(part, Solubility):
                _check_solubility(file, unit, part)
            if isinstance(part, Seed):
                _check_seed(file, unit, part)


def check_moved_solubility(units: Sequence[Unit], spans: Iterable, numbers: Numbers) -> list[str]:
    """Notes where a solubility falls to 0 within the temperatures that are studied or decided.

    `spans`: (name of a number, its lowest and highest value).
    """
    found = []
    for name, low, high in spans:
        unit = next((each for each in units if name == f"{each.name}.temperature"), None)
        part = None if unit is None else getattr(unit, "solubility", None)
        if isinstance(part, Solubility):
            at = np.linspace(low, high, POINTS)
            value = nominal_solubility(part, at)
            if (value <= 0).any():
                worst = int(np.argmin(value))
                found.append(
                    f"{numbers.givens[name].name} may come to {at[worst]:.6g} K, where the "
                    f"solubility is {value[worst]:.4g} kg/m3, which cannot be."
                )
    return found


def _unusual(given: Given) -> list[str]:
    for unit, ends, low, high, words in USUAL:
        if given.unit == unit and given.name.endswith(ends):
            odd = given.values[(given.values < low) | (given.values > high)]
            if odd.size:
                own = "" if unit == "1" else f" {unit}"
                return [f"{given.name} is {odd[0]:.6g}{own}: {words}."]
    return []


def _check_feed(file, feed: Feed, network: Network) -> None:
    dissolved = float(network.molar_mass @ feed.concentration.values)
    total = dissolved + float(feed.solvent.values[0])
    if total > LIQUID.high:
        what = (
            f"solvent and what is dissolved weigh {total:.6g} kg in a cubic metre, and at most "
            f"{LIQUID.high:g} are allowed"
        )
        raise CaseError(str(file), f"feeds.{feed.name}", None, what)


def _check_solubility(file, unit: Unit, part: Solubility) -> None:
    value = getattr(unit, "temperature")  # noqa: B009
    nodes = (value.value if isinstance(value, Profile) else value).values
    at = np.linspace(nodes.min(), nodes.max(), POINTS)
    found = nominal_solubility(part, at)
    worst = int(np.argmin(found))
    if not found[worst] > 0:
        what = (
            f"at {at[worst]:.6g} K, which {unit.name} comes to, it is {found[worst]:.4g} kg/m3; "
            "allowed is above 0"
        )
        raise CaseError(str(file), f"units.{unit.name}.solubility", None, what)


def _check_seed(file, unit: Unit, seed: Seed) -> None:
    density, shape = (float(getattr(unit, key).values[0]) for key in ("density", "shape"))
    if seed.loading is not None:
        share = float(seed.loading.values[0]) / density
    elif seed.moments is not None:
        share = shape * float(seed.moments.values[3])
    else:
        return
    if share >= PACKED:
        what = (
            f"the seed takes {100 * share:.4g} % of the volume; allowed is less than "
            f"{100 * PACKED:g} %"
        )
        raise CaseError(str(file), f"units.{unit.name}.seed", None, what)
