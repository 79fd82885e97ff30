"""A recipe as a table of setpoints for a control system, with their times in seconds."""

from collections.abc import Iterable, Mapping

from snapo.case.quantity import numbers_in

from .flowsheet.case import PharmaCase
from .given import Entry
from .time.profile import Profile, weights
from .units.operation import Unit

HEADER = ("unit", "setpoint", "kind", "time_s", "value", "value_unit")


def setpoints(case: PharmaCase, changed: Mapping[Entry, float] | None = None) -> Iterable[tuple]:
    """One row for each node of a profile, and for each other number that may be chosen.

    `changed`: numbers that replace those of the case, in the domain's units. `kind` "linear": the
    setpoint changes linearly to the next one; "constant": it stays until the next one; "once": it
    does not change.
    """
    changed = changed or {}
    selected = {
        (parameter.input, parameter.entry) for parameter in case.parameters if parameter.control
    } | set(changed)
    for unit in case.units:
        inside = {profile.value.name for profile in unit.profiles}
        seconds = 0.0
        if unit.time is not None:
            seconds = changed.get((unit.time.name, 0), float(unit.time.used()))
            yield unit.name, unit.time.name, "once", 0.0, seconds, "s"
            inside.add(unit.time.name)
        for profile in unit.profiles:
            inputs = profile.value
            values = [
                changed.get((inputs.name, int(i)), float(inputs.values[i])) for i in inputs.index
            ]
            values = _flow(case, unit, profile, values, seconds, changed)
            for share, value in zip(profile.share, values):
                row = unit.name, inputs.name, profile.kind
                yield *row, float(share) * seconds, value, inputs.unit
        yield from _once(unit, inside, selected, changed)
    for feed in case.feeds:
        yield from _once(feed, set(), selected, changed)


def _flow(case: PharmaCase, unit: Unit, profile: Profile, values, seconds, changed) -> list[float]:
    """The values of a dosed flow, scaled so that it adds up to the volume of its feed."""
    inlet = next((item.name for item in unit.inlets if item.dosed is profile), None)
    source = [c.source for c in case.connections if (c.target, c.inlet) == (unit.name, inlet)]
    feed = next((entry for entry in case.feeds if entry.name in source), None)
    mean = float(weights(profile) @ values)
    if feed is None or mean <= 0:
        return values
    volume = changed.get((feed.volume.name, 0), float(feed.volume.used()))
    return [value * volume / (seconds * mean) for value in values]


def _once(record, available: set[str], selected: set[Entry], changed) -> Iterable[tuple]:
    """The numbers of a unit or a feed that may be chosen, except those that are `available`
    already."""
    for values in numbers_in(record):
        for i, value in enumerate(values.values.tolist()):
            if values.name not in available and (values.name, i) in selected:
                many = len(values.values) > 1
                label = f"{values.name}[{values.labels[i]}]" if many else values.name
                now = changed.get((values.name, i), value)
                yield record.name, label, "once", 0.0, now, values.unit
