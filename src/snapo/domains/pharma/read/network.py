"""Reads species, reactions and feeds; a reaction must conserve mass."""

import re
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import Given
from snapo.case.table import Section, parse

from ..flowsheet.feed import Feed
from ..flowsheet.network import Network
from .names import check_name
from .numbers import ANY, LIQUID, NOT_NEGATIVE, POSITIVE, Bounds, absent, given, quantity, suggest
from .quantities import prefactor_unit
from .reader import Reader
from .tables import FeedTable, ReactionTable, SpeciesTable

TERM = re.compile(r"(?:(\d+\.?\d*|\.\d+)\s*)?([A-Za-z][A-Za-z0-9_-]*)")
MASS_TOLERANCE = 1e-4  # textbooks give molar masses to a few digits: 211.22 for 211.213
ROUND_OFF = 1e-12


def read_network(
    file, species: dict, reactions: list[dict], reference: Any, notes: list[str]
) -> Network:
    """The reactions of the case; without any, nothing reacts."""
    section = Section(file, "species", notes)
    names = tuple(check_name(section, each, each) for each in species)
    if not names:
        raise CaseError(str(file), "species", None, "a case needs one species or more")
    masses = []
    for name, raw in species.items():
        table = parse(SpeciesTable, raw, str(file), f"species.{name}")
        inner = Section(file, f"species.{name}", notes)
        masses.append(quantity(inner, "molar_mass", table.molar_mass, "kg/kmol", POSITIVE))
    molar_mass = np.array(masses)
    read = [_reaction(file, raw, i, names, molar_mass, notes) for i, raw in enumerate(reactions)]
    labels = tuple(each["name"] for each in read)
    for i, label in enumerate(labels):
        if label in labels[:i]:
            where = f"reactions[{i}].name"
            raise CaseError(str(file), where, label, "another reaction has this name")
    count, size = len(read), len(names)
    temperature = None
    if reference is not None:
        top = Section(file, "case", notes)
        temperature = quantity(top, "reference_temperature", reference, "K", POSITIVE)
    units = {each["unit"] for each in read}
    unit = units.pop() if len(units) == 1 else "(m3/kmol)^(order-1)/s"

    def of_all(key: str, measured: str, bounds: Bounds = ANY) -> Given:
        if not count:
            return absent(f"kinetics.{key}", measured)
        values = np.array([each[key] for each in read])
        words = ReactionTable.model_fields[key].title or ""
        return given(f"kinetics.{key}", values, labels, measured, words=words, bounds=bounds)

    return Network(
        species=names,
        molar_mass=molar_mass,
        reactions=labels,
        stoichiometry=np.array([each["row"] for each in read]).reshape(count, size),
        order=np.array([each["order"] for each in read]).reshape(count, size),
        prefactor=of_all("prefactor", unit, NOT_NEGATIVE),
        activation=of_all("activation", "J/mol"),
        heat=of_all("heat", "J/mol"),
        reference=temperature,
    )


def _reaction(file, raw, i: int, species, molar_mass, notes) -> dict[str, Any]:
    where = f"reactions[{i}]"
    table = parse(ReactionTable, raw, str(file), where)
    section = Section(file, where, notes)
    name = check_name(section, "name", table.name)
    left, right = _sides(section, table.equation, species)
    used, made = left @ molar_mass, right @ molar_mass
    gap = abs(made - used) / used
    if gap > MASS_TOLERANCE:
        what = (
            f"mass is not conserved: the left side weighs {used:.10g} g/mol and the right side "
            f"{made:.10g} g/mol"
        )
        raise section.error("equation", table.equation, what)
    if gap > ROUND_OFF:
        notes.append(
            f"Reaction {name} conserves mass to {gap:.1e} only, as its molar masses are given; the "
            "balance of mass shows this as made by the reaction."
        )
    order = left.copy()
    for each, exponent in table.order.items():
        at = _species(section, f"order.{each}", each, species)
        order[at] = quantity(section, f"order.{each}", exponent, "1", NOT_NEGATIVE)
    total = order.sum()
    unit = prefactor_unit(total)
    return {
        "name": name,
        "row": right - left,
        "order": order,
        "unit": unit,
        "prefactor": quantity(section, "prefactor", table.prefactor, unit, NOT_NEGATIVE),
        "activation": quantity(section, "activation", table.activation, "J/mol"),
        "heat": quantity(section, "heat", table.heat, "J/mol"),
    }


def _sides(section: Section, equation: str, species) -> tuple[np.ndarray, np.ndarray]:
    """What one mole of reaction uses and makes, [S] each."""
    sides = equation.split("->")
    if len(sides) != 2:
        raise section.error("equation", equation, 'allowed is an equation such as "A + 2 B -> C"')
    found = []
    for side in sides:
        amounts = np.zeros(len(species))
        for term in side.split("+"):
            match = TERM.fullmatch(term.strip())
            if match is None:
                what = 'allowed is an equation such as "A + 2 B -> C"'
                raise section.error("equation", equation, what)
            at = _species(section, "equation", match[2], species, equation)
            amounts[at] += float(match[1] or 1)
        found.append(amounts)
    if not (found[0] @ found[0] and found[1] @ found[1]):
        raise section.error("equation", equation, "both sides need a species")
    return found[0], found[1]


def _species(section: Section, key: str, name: str, species, shown=None) -> int:
    if name not in species:
        what = f"there is no species {name}; {suggest(name, species, 'species')}"
        raise section.error(key, name if shown is None else shown, what)
    return species.index(name)


def read_feeds(file, feeds: dict, species: tuple[str, ...], notes: list[str]) -> tuple[Feed, ...]:
    """`[feeds.NAME]`, in the order of the file."""
    found = []
    for name, raw in feeds.items():
        where = f"feeds.{name}"
        section = Section(file, where, notes)
        check_name(Section(file, "feeds", notes), name, name)
        table = parse(FeedTable, raw, str(file), where)
        amounts = np.zeros(len(species))
        for each, raw_amount in table.concentration.items():
            at = _species(section, f"concentration.{each}", each, species)
            key = f"concentration.{each}"
            amounts[at] = quantity(section, key, raw_amount, "kmol/m3", NOT_NEGATIVE)
        duration = None
        if table.duration is not None:
            duration = quantity(section, "duration", table.duration, "s", POSITIVE)
        read = Reader(section, name, table)
        words = "concentration in the feed"
        found.append(
            Feed(
                name=name,
                volume=read.number("volume", "m3", POSITIVE),
                temperature=read.number("temperature", "K", POSITIVE),
                concentration=given(
                    f"{name}.concentration",
                    amounts,
                    species,
                    "kmol/m3",
                    words=words,
                    bounds=NOT_NEGATIVE,
                ),
                solvent=read.number("solvent", "kg/m3", LIQUID),
                duration=duration,
            )
        )
    return tuple(found)
