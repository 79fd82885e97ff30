"""Checks of a whole case: decisions, held and varied numbers, and doses fit the flowsheet."""

from collections.abc import Sequence

import numpy as np

from snapo.case.error import CaseError

from ...control.staging import staged
from ...flowsheet.case import Connection, PharmaCase
from ...flowsheet.feed import Feed
from ...flowsheet.order import ancestors, groups, settled
from ...quality.draws import process_entries
from ...time.profile import Profile, weights
from ...units.operation import Inlet, Unit, timed

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
            message = "a policy decides on units, and this number is none of a unit"
        elif unit in over_time:
            profiles = [profile.value.name for profile in unit.profiles]
            if item.input in profiles:
                continue
            message = (
                f"{name}: a policy decides fields that change over time: {', '.join(profiles)}"
            )
        elif name in needed:
            message = f"{name} runs before a unit over whose time a policy decides or measures"
        else:
            continue
        raise CaseError(str(case.file), f"control.manipulated[{i}].of", item.input, message)


def check_moved(case: PharmaCase) -> None:
    """What is decided or uncertain cannot be held."""
    tables = {
        "optimise.decisions": case.optimise.decisions if case.optimise else (),
        "control.manipulated": case.control.manipulated if case.control else (),
    }
    moved = [(f"{key}[{i}]", x.input) for key, xs in tables.items() for i, x in enumerate(xs)]
    moved += [("uncertainty", name) for name in case.uncertainty.inputs]
    for where, name in moved:
        if name in case.held:
            message = "this number is among those `held`, which do not move"
            raise CaseError(str(case.file), f"{where}.of", name, message)


def check_varied_once(case: PharmaCase) -> None:
    """A number varies as a process parameter or as an uncertain one, not both."""
    uncertain = set(zip(case.uncertainty.inputs, case.uncertainty.entries))
    for name, entry in process_entries(case):
        if (name, entry) in uncertain:
            message = "this number has a distribution under [[parameters]] as well"
            raise CaseError(str(case.file), "uncertainty", f"{name}[{entry}]", message)


def check_amounts(
    file,
    feeds: Sequence[Feed],
    units: Sequence[Unit],
    connections: Sequence[Connection],
    notes: list[str],
) -> None:
    """Continuous units need a feed that lasts as long as they; a dose adds up to its feed."""
    by_name = {feed.name: feed for feed in feeds}
    lasting = _lasting(feeds, units, connections)
    for group in groups(units, connections):
        flows = [lasting[unit.name, port.name] for unit in group.units for port in unit.inlets]
        if group.torn and not all(flows):
            message = (
                f"a batch reaches the loop {group.loop}, which is solved at its steady state: "
                "every feed of it needs a duration, and its units take flows"
            )
            raise CaseError(str(file), "connections", None, message)
    for unit in units:
        fed = {c.inlet: by_name.get(c.source) for c in connections if c.target == unit.name}
        for inlet in unit.inlets:
            feed = fed.get(inlet.name)
            if feed is not None and inlet.dosed is not None:
                _check_dose(file, unit, feed, inlet.dosed)
            if feed is not None and inlet.lasting and feed.duration is None:
                message = f"unit {unit.name} runs continuously and needs to know over which time"
                raise CaseError(str(file), f"feeds.{feed.name}.duration", None, message)
            if inlet.lasting and not lasting[unit.name, inlet.name]:
                message = (
                    f"unit {unit.name} runs continuously, and a batch reaches its inlet "
                    f"{inlet.name}: every feed of a flow needs a duration"
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
    """Refuses ranges of numbers, studied or decided, for which a unit would use more than its feed.

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
            f"{unit.name} {verb} {runs:.10g} s, and its inlet {inlet.name} flows for "
            f"{flows:.10g} s; allowed is up to {flows:.10g} s, or a feed that lasts longer"
        )
        raise CaseError(str(file), where, f"{runs:.10g} s", message)


def _check_shape(file, where: str, unit: Unit, dosing: Profile) -> None:
    if dosing.value.values.size == 1:
        message = (
            "a flow of one value is set by the volume of its feed and the duration of "
            f"{unit.name}, which may vary in its place"
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
    """A remark where flows of unlike durations meet."""
    times = sorted({f.duration for f in fed if f is not None and f.duration is not None})
    if len(times) < 2:
        return []
    return [
        f"{unit.name} takes in flows of {times[0]:g} to {times[-1]:g} s: all are spread evenly "
        f"over {times[-1]:g} s."
    ]


def _check_dose(file, unit: Unit, feed: Feed, dosing: Profile) -> None:
    assert unit.time is not None
    duration = float(unit.time.values[0])
    dosed = duration * float(weights(dosing) @ dosing.value.used())
    held = float(feed.volume.values[0])
    if abs(dosed - held) > 1e-9 * held:
        message = (
            f"over {duration:g} s it doses {dosed:.10g} m3, and feed {feed.name} holds "
            f"{held:.10g} m3"
        )
        raise CaseError(str(file), f"units.{unit.name}.dosing", None, message)


def _steep(profile: Profile, duration: float) -> list[str]:
    """A remark where an open-loop profile moves faster than its ramp allows."""
    if profile.ramp is None or profile.kind == "constant":
        return []
    slope = np.abs(np.diff(profile.value.values) / np.diff(profile.share)) / duration
    if slope.max() <= profile.ramp * (1 + 1e-9):
        return []
    unit = profile.value.unit
    return [
        f"{profile.value.name} moves by {60 * slope.max():.3g} {unit}/min at most, and its ramp "
        f"allows {60 * profile.ramp:.3g} {unit}/min."
    ]
