"""Profiles over a unit's time: their value anywhere, on a mesh, and with more nodes."""

from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snapo.case.given import Given

from .inputs import fixed
from .records import PharmaCase
from .records_units import Profile


def values_in(
    profile: Profile, value: Float[Array, " N"], piece: Int[Array, "..."], share
) -> Float[Array, "..."]:
    """The profile at shares of the duration that lie in its pieces number `piece`.

    The piece is given, not searched for: at a jump both sides can be asked for, and the adjoint
    to the nodes is a gather.
    """
    if profile.kind == "constant":
        return jnp.broadcast_to(value[piece], jnp.shape(share))
    start = fixed(profile.share)[piece]
    slope = jnp.diff(value) / np.diff(profile.share)
    return value[piece] + slope[piece] * (share - start)


def values_at(profile: Profile, value: Float[Array, " N"], share) -> Float[Array, "..."]:
    """The profile at any shares of the duration; at a jump the later value."""
    inner = fixed(profile.share[1:-1])
    return values_in(profile, value, jnp.searchsorted(inner, share, side="right"), share)


def mean_value(profile: Profile, value: Float[Array, " N"]) -> Float[Array, ""]:
    """The mean over the duration."""
    width = np.diff(profile.share)
    if profile.kind == "constant":
        return jnp.sum(width * value)
    return jnp.sum(width * (value[1:] + value[:-1])) / 2


def profiles_of(unit) -> tuple[Profile, ...]:
    """The profiles of a unit and of its jacket."""
    owners = [unit, getattr(unit, "jacket", None)]
    found = [getattr(each, field.name) for each in owners if each for field in fields(each)]
    return tuple(each for each in found if isinstance(each, Profile))


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
