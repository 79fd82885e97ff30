"""Checks of a whole case: whether decisions, held and varied numbers, and doses fit the flowsheet.
Numbers that are possible but unlikely are noted; numbers that are impossible together are refused.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from snapo.case.error import CaseError
from snapo.case.plausible import CaseFiles, CheckedNumbers, Plausible, checked_numbers, implausible
from snapo.case.quantity import numbers_in
from snapo.case.table import TableContext

from ...control.staging import staged
from ...flowsheet.case import Connection, PharmaCase, process_entries
from ...flowsheet.feed import Feed
from ...flowsheet.network import FlowNetwork
from ...flowsheet.order import ancestors, groups, settled
from ...given import Entry
from ...quality.records import Distribution
from ...time.profile import Profile, weights
from ...units.crystals.seed import Seed
from ...units.crystals.solubility import Solubility, nominal_solubility
from ...units.operation import Inlet, Unit, timed
from ..entries import EntryNumbers, limits
from ..numbers import LIQUID

MINIMUM = 1e-9  # s: of a flow whose duration is still unknown


def check_decided(case: PharmaCase) -> None:
    """A policy decides profiles of units that take time, and numbers of units after these."""
    control = case.control
    if control is None:
        return
    by_name = {unit.name: unit for unit in case.units}
    before = ancestors(case.units, case.connections)
    over_time = timed(case.units)
    needed = set().union(*(before[unit.name] for unit in staged(case.units, control)))
    for i, item in enumerate(control.manipulated):
        name = item.input.partition(".")[0]
        unit = by_name.get(name)
        if unit is None:
            message = "a policy decides on units, but this number does not belong to a unit"
        elif unit in over_time:
            profiles = [profile.value.name for profile in unit.profiles]
            if item.input in profiles:
                continue
            message = (
                f"{name}: a policy decides fields that change over time: {', '.join(profiles)}"
            )
        elif name in needed:
            message = (
                f"{name} comes before a unit in which the policy decides or measures over time, so "
                "its numbers cannot be decided"
            )
        else:
            continue
        raise CaseError(str(case.file), f"control.manipulated[{i}].of", item.input, message)


def check_moved(case: PharmaCase) -> None:
    """Numbers that are decided, uncertain, fitted or set by an experiment cannot be held."""
    estimation = case.estimation
    tables = {
        "optimise.decisions": [x.input for x in case.optimise.decisions] if case.optimise else (),
        "control.manipulated": [x.input for x in case.control.manipulated] if case.control else (),
        "estimation.fit": estimation.inputs if estimation else (),
    }
    varied = [(f"{key}[{i}].of", name) for key, xs in tables.items() for i, name in enumerate(xs)]
    varied += [("uncertainty.of", name) for name in case.uncertainty.inputs]
    for x in (*estimation.experiments, *estimation.held_out) if estimation else ():
        varied += [(f"estimation.experiments.{x.name}.settings", name) for name, *_ in x.settings]
    for where, name in varied:
        if name in case.held:
            message = "this number is in the list `held`, whose numbers cannot be varied"
            raise CaseError(str(case.file), where, name, message)


def check_varied_once(case: PharmaCase) -> None:
    """A number varies as a process parameter or as an uncertain one, not both."""
    uncertain = set(zip(case.uncertainty.inputs, case.uncertainty.entries))
    for name, entry in process_entries(case):
        if (name, entry) in uncertain:
            message = "this number has a distribution under [[parameters]] as well; keep only one"
            raise CaseError(str(case.file), "uncertainty", f"{name}[{entry}]", message)


def check_amounts(
    file,
    feeds: Sequence[Feed],
    units: Sequence[Unit],
    connections: Sequence[Connection],
    notes: list[str],
) -> None:
    """Checks that the feed of a continuous unit lasts as long as the unit, and a dose adds up to
    its feed."""
    by_name = {feed.name: feed for feed in feeds}
    lasting = _lasting(feeds, units, connections)
    for group in groups(units, connections):
        flows = [lasting[unit.name, port.name] for unit in group.units for port in unit.inlets]
        if group.torn and not all(flows):
            message = (
                f"a batch reaches the loop {group.loop}, which is solved at its steady state: "
                "every feed of the loop needs a duration, because its units take only flows"
            )
            raise CaseError(str(file), "connections", None, message)
    for unit in units:
        fed = {c.inlet: by_name.get(c.source) for c in connections if c.target == unit.name}
        for inlet in unit.inlets:
            feed = fed.get(inlet.name)
            if feed is not None and inlet.dosed is not None:
                _check_dose(file, unit, feed, inlet.dosed)
            if feed is not None and inlet.lasting and feed.duration is None:
                message = f"unit {unit.name} runs continuously, so its feed needs a duration"
                raise CaseError(str(file), f"feeds.{feed.name}.duration", None, message)
            if inlet.lasting and not lasting[unit.name, inlet.name]:
                message = (
                    f"unit {unit.name} runs continuously, and a batch reaches its inlet "
                    f"{inlet.name}: every feed that reaches the unit needs a duration"
                )
                raise CaseError(str(file), f"units.{unit.name}", None, message)
            if inlet.lasting and unit.time is not None:
                runs, flows = float(unit.time.used()), lasting[unit.name, inlet.name]
                _check_end(file, f"units.{unit.name}.duration", unit, inlet, runs, flows, "runs")
        notes += _uneven(unit, fed.values())
        if unit.time is not None:
            for profile in unit.profiles:
                notes += _steep(profile, float(unit.time.values[0]))


def check_spans(case: PharmaCase, spans: Sequence[tuple[str, str, float]]) -> None:
    """Refuses studied or decided ranges of numbers for which a unit would use more than its feed.
    `spans`: position in the case, name of the number, and its highest value.
    """
    flows, file = _lasting(case.feeds, case.units, case.connections), case.file
    for unit in case.units:
        for inlet in unit.inlets:
            for where, name, high in spans:
                if inlet.lasting and unit.time is not None and name == unit.time.name:
                    _check_end(
                        file, where, unit, inlet, high, flows[unit.name, inlet.name], "may run"
                    )
                if inlet.dosed is not None and name == inlet.dosed.value.name:
                    _check_shape(file, where, unit, inlet.dosed)


def _check_end(file, where: str, unit: Unit, inlet: Inlet, runs: float, flows: float, verb) -> None:
    if runs > flows * (1 + 1e-9):
        message = (
            f"{unit.name} {verb} {runs:.10g} s, but its inlet {inlet.name} flows for "
            f"{flows:.10g} s; use at most {flows:.10g} s, or a feed that lasts longer"
        )
        raise CaseError(str(file), where, f"{runs:.10g} s", message)


def _check_shape(file, where: str, unit: Unit, dosing: Profile) -> None:
    if dosing.value.values.size == 1:
        message = (
            "a constant flow follows from the volume of its feed and the duration of "
            f"{unit.name}; vary one of these instead"
        )
        raise CaseError(str(file), where, dosing.value.name, message)


def _lasting(feeds, units, connections) -> dict[tuple[str, str], float]:
    """{(unit, inlet): duration of the inflow in s, 0 for a batch}; units in the order of flow."""
    fed = {(f.name, ""): f.duration or 0.0 for f in feeds}
    # The recycle of a loop flows for as long as its feed.
    _, into = settled(units, connections, fed, MINIMUM, lambda unit, flows: unit.lasts(flows))
    return {
        (unit.name, inlet.name): lasts
        for unit in units
        for inlet, lasts in zip(unit.inlets, into[unit.name])
    }


def _uneven(unit: Unit, fed) -> list[str]:
    """A remark if flows of different durations meet."""
    times = sorted({f.duration for f in fed if f is not None and f.duration is not None})
    if len(times) < 2:
        return []
    return [
        f"{unit.name} takes in flows that last {times[0]:g} to {times[-1]:g} s; all are spread "
        f"evenly over {times[-1]:g} s."
    ]


def _check_dose(file, unit: Unit, feed: Feed, dosing: Profile) -> None:
    assert unit.time is not None
    duration = float(unit.time.values[0])
    dosed = duration * float(weights(dosing) @ dosing.value.used())
    held = float(feed.volume.values[0])
    if abs(dosed - held) > 1e-9 * held:
        message = (
            f"over {duration:g} s it doses {dosed:.10g} m3, but feed {feed.name} holds "
            f"{held:.10g} m3; the two must be equal"
        )
        raise CaseError(str(file), f"units.{unit.name}.dosing", None, message)


def _steep(profile: Profile, duration: float) -> list[str]:
    """A remark if an open-loop profile changes faster than its ramp allows."""
    if profile.ramp is None or profile.kind == "constant":
        return []
    slope = np.abs(np.diff(profile.value.values) / np.diff(profile.share)) / duration
    if slope.max() <= profile.ramp * (1 + 1e-9):
        return []
    unit = profile.value.unit
    return [
        f"{profile.value.name} changes by up to {60 * slope.max():.3g} {unit}/min, but its ramp "
        f"allows only {60 * profile.ramp:.3g} {unit}/min."
    ]


RANGES = (
    Plausible(200.0, 500.0, "processes in liquids usually run from 200 to 500 K", unit="K"),
    Plausible(800.0, 5000.0, "the density of crystals is usually 800 to 5000 kg/m^3", unit="kg/m3",
              endings=(".density",)),
    Plausible(0.25, 0.75, "the porosity of a cake is usually 0.25 to 0.75", unit="1",
              endings=(".porosity",)),
    Plausible(0.01, 1.5, "it is 0.52 for a sphere and 1 for a cube", unit="1", endings=(".shape",)),
    Plausible(1.0, 6.048e5, "units usually run from seconds to a week; is it in hours or minutes?",
              unit="s", endings=(".duration", ".time")),
    Plausible(1e-9, 0.01, "the size of crystals and films is usually nanometres to "
        "millimetres", unit="m",
              endings=(".size", "_size", ".film")),
    Plausible(1e3, 1e6, "energies of activation and heats are usually 1 to 1,000 kJ/mol",
              unit="J/mol", by_size=True),
    Plausible(1e-9, 60.0, "water itself is 55 mol/L", unit="kmol/m3"),
    Plausible(1.0, 1e9, "100,000 Pa are 1 bar", unit="Pa"),
    Plausible(1e-6, 1e3, "water has 0.001 Pa*s", unit="Pa*s"),
    Plausible(1e-14, 1e-3, "in liquids it is usually about 1e-9 m^2/s", unit="m2/s"),
    Plausible(1e-9, 1e4, "1 L is 0.001 m3", unit="m3"),
    Plausible(1e-12, 1e-3, "1 um/s is 1e-6 m/s", unit="m/s"),
    Plausible(1.0, 1e6, "a molar mass is in g/mol: that of water is 18", unit="g/mol"),
)  # fmt: skip
PACKED = 0.5  # of the volume: a slurry with more seed than this does not move
POINTS = 65  # between the lowest and the highest temperature


def check_physics(file, feeds: Sequence[Feed], units: Sequence[Unit], network: FlowNetwork) -> None:
    """Refuses impossible values; the message has the allowed range."""
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
    """Notes on numbers that are possible, but are probably in the wrong unit."""
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
            f"solvent and dissolved species weigh {total:.6g} kg in a cubic metre, but at most "
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
            f"at {at[worst]:.6g} K, which {unit.name} reaches, the solubility is "
            f"{result[worst]:.4g} kg/m3; it must be above 0"
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
            f"the seed takes {100 * share:.4g} % of the volume; it must be less than "
            f"{100 * PACKED:g} %"
        )
        raise CaseError(str(file), f"units.{unit.name}.seed", None, message)


REFUSED, NOTED = 1e-3, 1e-7  # of the draws


def check_drawn(
    section: TableContext, raw: Any, distribution: Distribution, numbers: EntryNumbers, entry: Entry
) -> None:
    """Refuses a distribution of which one draw in a thousand is impossible; notes rarer ones."""
    values = numbers.givens[entry[0]]
    share = outside(distribution, numbers.value(entry), values.low, values.high)
    if share <= NOTED:
        return
    metadata = f"{100 * share:.2g} % of its draws are impossible values of {numbers.name_of(entry)}"
    metadata += f" ({limits(values)})"
    if share > REFUSED:
        hint = "" if values.low < 0 else '; kind "lognormal" stays above 0'
        raise section.error("distribution", raw, f"{metadata}{hint}")
    section.notes.append(f"{section.name}: {metadata}.")


def outside(distribution: Distribution, centre: float, low: float, high: float) -> float:
    """The share of draws below `low` or above `high`; formulas in `Distribution`."""
    spread = distribution.spread

    def normal(x: float) -> float:
        return math.erfc(-x / math.sqrt(2)) / 2

    def below(x: float) -> float:
        if math.isinf(x):
            return 0.0 if x < 0 else 1.0
        match distribution.kind:
            case "normal":
                return normal((x - centre) / spread)
            case "uniform":
                return min(1.0, max(0.0, ((x - centre) / spread + 1) / 2))
            case "lognormal" | "logarithm":
                if x <= 0 or x < 1e-300:
                    return 0.0
                median = -(spread**2) / 2 if distribution.kind == "lognormal" else 0.0
                return normal((math.log(x / centre) - median) / spread)

    return below(low) + 1 - below(high)
