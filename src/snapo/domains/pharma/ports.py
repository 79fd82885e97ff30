"""What each unit takes in and gives out, and what can be measured on it, by names."""

from .records_units import (
    Crystalliser,
    Dissolution,
    Dryer,
    Filter,
    Reactor,
    Splitter,
    Tank,
    TrayDryer,
    Unit,
)

QUANTILES = {"d10": "m", "d50": "m", "d90": "m"}  # by volume


def inlets(unit: Unit) -> tuple[str, ...]:
    """Names of the ports that must be fed, each by exactly one connection."""
    match unit:
        case Reactor():
            return ("feed", "dose") if unit.kind == "semi-batch" else ("feed",)
        case Crystalliser():
            return ("feed", "antisolvent") if unit.dosing is not None else ("feed",)
        case Filter():
            return ("slurry",)
        case Dryer() | TrayDryer():
            return ("cake",)
        case Dissolution():
            return ("product",)
        case Tank():
            return unit.inlets
        case Splitter():
            return ("feed",)


def outlets(unit: Unit) -> tuple[str, ...]:
    """Names of the ports that may feed another unit, each at most one; the rest leave as waste."""
    match unit:
        case Reactor() | Tank():
            return ("product",)
        case Crystalliser():
            return ("slurry",)
        case Filter():
            return ("cake", "filtrate", "washings")
        case Dryer() | TrayDryer():
            return ("product", "vapour")
        case Dissolution():
            return ()
        case Splitter():
            return unit.outlets


def measures(unit: Unit, species: tuple[str, ...]) -> dict[str, str]:
    """{measure: its unit in the domain} at the unit's end; attributes name them "unit.measure".

    Beside these stand "process.yield.PRODUCT.KEY", in "1": new crystals of PRODUCT, kmol, per
    kmol of KEY in all feeds; and "process.product.PRODUCT", the same crystals in kg.
    """
    match unit:
        case Reactor():
            return {f"concentration.{s}": "kmol/m3" for s in species} | {"temperature": "K"}
        case Crystalliser():
            sizes = {"d32": "m", "d43": "m"}
            found = {"concentration": "kg/m3", "crystals": "kg/m3", "supersaturation": "1"}
            if unit.separate:
                found |= {"seed_volume": "m3/m3", "nuclei_volume": "m3/m3"}
            if unit.edges is not None:
                sizes |= QUANTILES | {"span": "1", "at_largest": "1"}
            return found | sizes
        case Filter():
            found = {"time": "s", "resistance": "m/kg", "liquor": "m3/kg"}
            return found | {f"impurity.{s}": "1" for s in species}
        case Dryer() | TrayDryer():
            return {"solvent": "1", "temperature": "K"}
        case Dissolution():
            return {"dissolved": "1"}
        case _:
            return {}


def states(unit: Unit, species: tuple[str, ...]) -> dict[str, str]:
    """{state: its unit in the domain} over the unit's time: recorded, measured by a policy, fitted.

    A dryer's "solvent" is kg per kg of crystals, and its "rate" what leaves of it; "mu0" to "mu5"
    are m^k per m3.
    """
    match unit:
        case Reactor():
            return {f"concentration.{s}": "kmol/m3" for s in species} | {"temperature": "K"}
        case Crystalliser():
            found = {"concentration": "kg/m3", "supersaturation": "1", "temperature": "K"}
            moments = {f"mu{k}": "1/m3" if k == 0 else f"m^{k}/m3" for k in range(6)}
            sizes = {"d43": "m", "d32": "m"} | (QUANTILES if unit.edges is not None else {})
            return found | sizes | moments
        case Dryer():
            return {"solvent": "1", "temperature": "K"}
        case TrayDryer():
            found = {"solvent": "1", "temperature": "K", "rate": "1/s"}
            return found | {"shelf": "K", "pressure": "Pa"}
        case _:
            return {}
