"""A profile with more nodes, by which the derivative over time can be taken."""

from dataclasses import replace

import numpy as np

from snapo.case.given import Given

from ..flowsheet.case import PharmaCase
from ..time.profile import Profile


def with_nodes(case: PharmaCase, name: str, count: int) -> PharmaCase:
    """The case with `count` evenly spaced nodes in the linear profile "unit.temperature".

    The profile itself is the same where its old nodes are among the new ones, otherwise within
    the chords. Parameters that are entries of the profile are left out: they are other nodes now.
    """
    owner, _, field = name.partition(".")
    unit = next(each for each in case.units if each.name == owner)
    profile = getattr(unit, field)
    if not isinstance(profile, Profile) or profile.kind != "linear":
        raise ValueError(f"with_nodes: {name} is no piecewise linear profile.")
    share = np.linspace(0.0, 1.0, count)
    values = np.interp(share, profile.share, profile.value.used())
    labels = tuple(f"{each:.4g}" for each in share)
    given = Given(profile.value.name, values, labels, profile.value.unit, np.arange(count))
    finer = replace(unit, **{field: replace(profile, share=share, value=given)})
    return replace(
        case,
        units=tuple(finer if each is unit else each for each in case.units),
        parameters=tuple(each for each in case.parameters if each.input != name),
        pairs=(),
        design_space=None,
        control=None,
    )
