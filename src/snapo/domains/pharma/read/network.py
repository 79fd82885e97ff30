"""Reads species, reactions and feeds; a reaction must conserve mass."""

import re
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.quantity import Range
from snapo.case.table import TableContext, parse

from ..flowsheet.feed import Feed
from ..flowsheet.network import FlowNetwork
from .declared import values
from .names import check_name
from .numbers import (
    ANY,
    NOT_NEGATIVE,
    POSITIVE,
    absent,
    case_input,
    position,
    quantity,
    suggest,
)
from .quantities import prefactor_unit
from .reader import Reader
from .tables import ReactionTable, SpeciesTable

TERM = re.compile(r"(?:(\d+\.?\d*|\.\d+)\s*)?([A-Za-z][A-Za-z0-9_-]*)")
MASS_TOLERANCE = 1e-4  # textbooks give molar masses to a few digits: 211.22 for 211.213
ROUND_OFF = 1e-12


def read_network(
    file, species: dict, reactions: list[dict], reference: Any, notes: list[str]
) -> FlowNetwork:
    """The reactions of the case; without any, nothing reacts."""
    section = TableContext(file, "species", notes)
    names = tuple(check_name(section, name, name) for name in species)
    if not names:
        raise CaseError(str(file), "species", None, "a case needs one species or more")
    masses = []
    for name, raw in species.items():
        table = parse(SpeciesTable, raw, str(file), f"species.{name}")
        inner = TableContext(file, f"species.{name}", notes)
        masses.append(quantity(inner, "molar_mass", table.molar_mass, "kg/kmol", POSITIVE))
    molar_mass = np.array(masses)
    read = [_reaction(file, raw, i, names, molar_mass, notes) for i, raw in enumerate(reactions)]
    labels = tuple(item["name"] for item in read)
    for i, label in enumerate(labels):
        if label in labels[:i]:
            where = f"reactions[{i}].name"
            raise CaseError(str(file), where, label, "another reaction has this name")
    count, size = len(read), len(names)
    temperature = None
    if reference is not None:
        top = TableContext(file, "case", notes)
        temperature = quantity(top, "reference_temperature", reference, "K", POSITIVE)
    units = {entry["unit"] for entry in read}
    unit = units.pop() if len(units) == 1 else "(m3/kmol)^(order-1)/s"

    def of_all(key: str, measured: str, bounds: Range = ANY) -> CaseInput:
        if not count:
            return absent(f"kinetics.{key}", measured)
        values = np.array([value[key] for value in read])
        text = ReactionTable.model_fields[key].title or ""
        where = tuple(
            position(item["section"], key, item["unit"] if key == "prefactor" else measured)
            for item in read
        )
        return case_input(
            f"kinetics.{key}",
            values,
            labels,
            measured,
            meaning=text,
            bounds=bounds,
            positions=where,
        )

    return FlowNetwork(
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
    section = TableContext(file, where, notes)
    name = check_name(section, "name", table.name)
    left, right = _sides(section, table.equation, species)
    used, made = left @ molar_mass, right @ molar_mass
    gap = abs(made - used) / used
    if gap > MASS_TOLERANCE:
        message = (
            f"mass is not conserved: the left side weighs {used:.10g} g/mol and the right side "
            f"{made:.10g} g/mol"
        )
        raise section.error("equation", table.equation, message)
    if gap > ROUND_OFF:
        notes.append(
            f"Reaction {name} conserves mass to {gap:.1e} only, as its molar masses are given; the "
            "balance of mass shows this as produced by the reaction."
        )
    order = left.copy()
    for item, exponent in table.order.items():
        at = _species(section, f"order.{item}", item, species)
        order[at] = quantity(section, f"order.{item}", exponent, "1", NOT_NEGATIVE)
    total = order.sum()
    unit = prefactor_unit(total)
    return {
        "name": name,
        "section": section,
        "row": right - left,
        "order": order,
        "unit": unit,
        "prefactor": quantity(section, "prefactor", table.prefactor, unit, NOT_NEGATIVE),
        "activation": quantity(section, "activation", table.activation, "J/mol"),
        "heat": quantity(section, "heat", table.heat, "J/mol"),
    }


def _sides(section: TableContext, equation: str, species) -> tuple[np.ndarray, np.ndarray]:
    """What one mole of reaction uses and makes, [S] each."""
    sides = equation.split("->")
    if len(sides) != 2:
        raise section.error("equation", equation, 'allowed is an equation such as "A + 2 B -> C"')
    results = []
    for side in sides:
        amounts = np.zeros(len(species))
        for term in side.split("+"):
            match = TERM.fullmatch(term.strip())
            if match is None:
                message = 'allowed is an equation such as "A + 2 B -> C"'
                raise section.error("equation", equation, message)
            at = _species(section, "equation", match[2], species, equation)
            amounts[at] += float(match[1] or 1)
        results.append(amounts)
    if not (results[0] @ results[0] and results[1] @ results[1]):
        raise section.error("equation", equation, "both sides need a species")
    return results[0], results[1]


def _species(section: TableContext, key: str, name: str, species, displayed=None) -> int:
    if name not in species:
        message = f"there is no species {name}; {suggest(name, species, 'species')}"
        raise section.error(key, name if displayed is None else displayed, message)
    return species.index(name)


def read_feeds(file, feeds: dict, species: tuple[str, ...], notes: list[str]) -> tuple[Feed, ...]:
    """`[feeds.NAME]`, in the order of the file."""
    results = []
    for name, raw in feeds.items():
        where = f"feeds.{name}"
        section = TableContext(file, where, notes)
        check_name(TableContext(file, "feeds", notes), name, name)
        table: Any = parse(Feed.table, raw, str(file), where, notes)
        amounts = np.zeros(len(species))
        for item, raw_amount in table.concentration.items():
            at = _species(section, f"concentration.{item}", item, species)
            key = f"concentration.{item}"
            amounts[at] = quantity(section, key, raw_amount, "kmol/m3", NOT_NEGATIVE)
        read = Reader(section, name, table, raw)
        text = "concentration in the feed"
        results.append(
            Feed(
                name=name,
                concentration=case_input(
                    f"{name}.concentration",
                    amounts,
                    species,
                    "kmol/m3",
                    meaning=text,
                    bounds=NOT_NEGATIVE,
                    positions=tuple(
                        position(section, f"concentration.{item}", "kmol/m3") for item in species
                    ),
                ),
                **values(Feed, read),
            )
        )
    return tuple(results)
