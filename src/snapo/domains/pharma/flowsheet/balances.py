"""Inflow, outflow and accumulation of mass, every species, solvent and energy, per unit."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from snapo.study.chapter import Number

from .flow import leaving, sources
from .ledger import Ledger
from .process import Process
from .stream import Stream


@dataclass(frozen=True)
class Balance:
    """`relative`: (inflow + made - outflow - accumulation) over the largest; 0 where all are 0.

    What a unit has not taken in counts as accumulation. It cannot be less than nothing, so the
    balance of a unit that takes more than there is stays open.

    Of one batch. "mass" in kg; a species: kmol; `inflow` with seed, `made` by reactions, below 0
    where they use it (of mass: what molar masses of few digits leave over); "solvent": kg with
    anti-solvent and wash liquid; "energy": J, sensible heat above 0 K and of vapour its latent
    heat, `inflow` with what reactions release.
    """

    unit: str
    quantity: str
    inflow: Number
    made: Number
    outflow: Number
    accumulation: Number
    relative: Number


def balances(process: Process, inputs=None) -> list[Balance]:
    """The balances of every unit but tests of the product, and of the whole as unit "process"."""
    case = process.case

    def make(own: bool):
        def everything(given):
            found = process.flow(given, own=own)
            ledgers = {name: each.finish.ledger for name, each in found.outcomes.items()}
            return found.streams, ledgers, found.measures

        return everything

    streams, ledgers, _ = process.either(
        "balances", make, process.given(inputs), of=lambda found: found[2]
    )
    fed, found = sources(case), []
    for unit in case.units:
        out = [streams[f"{unit.name}.{port}"] for port in unit.outlets]
        if out:
            into = [streams[name] for name in fed[unit.name]]
            found += unit_balances(process, unit.name, into, out, [ledgers[unit.name]])
    into = [streams[each.name] for each in case.feeds]
    out = [streams[name] for name in leaving(case)]
    return found + unit_balances(process, "process", into, out, list(ledgers.values()))


def unit_balances(process: Process, name: str, into, out, ledgers: list[Ledger]) -> list[Balance]:
    """The balances of the units with these `ledgers`, between the streams into and out of them."""
    network = process.case.network
    made = np.sum([each.made for each in ledgers], axis=0)
    added = np.sum([each.added for each in ledgers], axis=0)
    held = np.sum([each.held + np.maximum(each.left, 0.0) for each in ledgers], axis=0)
    liquid = sum(each.solvent_added for each in ledgers)
    kept = sum(max(float(each.solvent_left), 0.0) for each in ledgers)
    fed, left = _species(into) + added, _species(out)
    solvent_in, solvent_out = _solvent(into) + liquid, _solvent(out)
    found = [
        _balance(
            name,
            "mass",
            network.molar_mass @ fed + solvent_in,
            network.molar_mass @ left + solvent_out,
            network.molar_mass @ held + kept,
            network.molar_mass @ made,
        )
    ]
    for s, species in enumerate(network.species):
        found.append(_balance(name, species, fed[s], left[s], held[s], made[s]))
    found.append(_balance(name, "solvent", solvent_in, solvent_out, kept))
    if name != "process" and ledgers[0].energy is not None:
        found.append(_balance(name, "energy", *ledgers[0].energy))
    return found


def _balance(unit: str, quantity: str, inflow, outflow, accumulation, made=0.0) -> Balance:
    gap = inflow + made - outflow - accumulation
    size = max(map(abs, (inflow, made, outflow, accumulation)))
    relative = float(gap / size) if size != 0 else 0.0
    stays = float(accumulation)
    return Balance(unit, quantity, float(inflow), float(made), float(outflow), stays, relative)


def _species(streams: Iterable[Stream]) -> np.ndarray:
    """[S] kmol dissolved and in crystals."""
    return np.sum([each.species + each.solid for each in streams], axis=0)


def _solvent(streams: Iterable[Stream]) -> float:
    return sum(float(each.solvent + each.antisolvent) for each in streams)
