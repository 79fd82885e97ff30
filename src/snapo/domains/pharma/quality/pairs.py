"""Proven ranges of two parameters together, and their interaction.

A proven range holds with all other parameters at their set point; at a corner of two ranges, limits
may fail. The line from the set point to each of the four corners, the same share of both ranges at
each point, is searched for the first failure: the smallest of the four shares is the share of both
ranges that may be used together.

The interaction of x and y in an attribute f is (f(+, +) - f(+, -) - f(-, +) + f(-, -)) / 4 at the
corners of the normal operating ranges: half of the change in the effect of one parameter that the
other causes, as in a factorial design at two levels. For f = c x y it is c times half of the range
of x and half of the range of y; for a sum of functions of x and of y it is zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from snapo.study.chapter import Floats, Number

from . import batches
from .batches import AttributeLimits
from .ranges import Changes, Good, goods
from .records import Parameter

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess

CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
NOMINAL = (16, 7, 2)  # shares evaluated, then within the bracket of an end; repetitions
PROBABLE = (8, 3, 1)  # every point of these is many batches
MAXIMUM = (
    10  # pairs of which the probable ranges are searched, those with the least room at a corner
)

PairEnds = tuple[float, float]  # of a range, in the domain's unit


@dataclass(frozen=True)
class Together:
    """The result for two ranges together. `share`: the largest share of both ranges at which no
    corner fails (1 if none fails). `corner` (-1 or 1, -1 or 1): the corner that fails first;
    `fails`: the number of the attribute that fails there, -1 if none fails. `certain`, `possible`:
    the share if the lower, or the upper, end of the 95 % interval of the probability must be above
    the required one."""

    share: Number
    corner: tuple[int, int]
    fails: int
    certain: Number
    possible: Number


@dataclass(frozen=True, eq=False)
class Pair:
    """Two parameters.

    - `nominal`, `probable`: their proven ranges together, None if one of them has no range or it
      was not searched.
    - `interaction`: [Q] in the attributes' units; `used`: its largest share of the distance to a
      limit, and `maximum`: the number of the attribute with this share, -1 if none has a limit.
    - `holds_normal`: whether the nominal model keeps all limits at the corners of normal operation.
    """

    names: tuple[str, str]
    nominal: Together | None
    probable: Together | None
    interaction: Floats
    used: Number
    maximum: int
    holds_normal: bool


Ranges = Mapping[str, PairEnds | None]  # of each parameter


def pairs(
    process: "PharmaProcess",
    nominal: Ranges,
    probable: Ranges,
    required: float,
    samples: int,
    seed: int,
) -> list[Pair]:
    """Every pair of the parameters, with both kinds of proven ranges of each."""
    both = list(combinations(process.case.parameters, 2))
    fixed, drawn = goods(process, required, samples, seed)
    plain = _together(process, both, nominal, fixed, NOMINAL)
    order = sorted(range(len(both)), key=lambda i: _room(plain[i]))[:MAXIMUM]
    selected = _together(process, [both[i] for i in order], probable, drawn, PROBABLE)
    drawn_of = dict(zip(order, selected))
    effects = _interactions(process, both)
    return [
        Pair((x.name, y.name), plain[i], drawn_of.get(i), *effects[i])
        for i, (x, y) in enumerate(both)
    ]


def _room(together: Together | None) -> float:
    return 1.0 if together is None else together.share


class _Way(NamedTuple):
    """The segment from the set point to one corner of a pair's ranges."""

    pair: int
    corner: tuple[int, int]
    start: PairEnds
    end: PairEnds
    parameters: tuple[Parameter, Parameter]

    def at(self, share: float) -> Changes:
        return {
            (p.input, p.entry): a + share * (b - a)
            for p, a, b in zip(self.parameters, self.start, self.end)
        }


def _ways(process: "PharmaProcess", both, ranges: Ranges) -> list[_Way]:
    ways = []
    for i, (x, y) in enumerate(both):
        sides = [
            bounds for bounds in (ranges.get(x.name), ranges.get(y.name)) if bounds is not None
        ]
        if len(sides) < 2:
            continue
        here = [float(process.inputs[p.input][p.entry]) for p in (x, y)]
        for corner in CORNERS:
            endpoints = [side[sign > 0] for side, sign in zip(sides, corner)]
            ways.append(_Way(i, corner, (here[0], here[1]), (endpoints[0], endpoints[1]), (x, y)))
    return ways


def _together(
    process: "PharmaProcess",
    both: Sequence,
    ranges: Ranges,
    valid: Good,
    search: tuple[int, int, int],
) -> list[Together | None]:
    ways = _ways(process, both, ranges)
    if not ways:
        return [None] * len(both)
    endpoints = _search(ways, valid, search)
    results: list[Together | None] = []
    for i in range(len(both)):
        local = [(end, key_path) for end, key_path in zip(endpoints, ways) if key_path.pair == i]
        if not local:
            results.append(None)
            continue
        (share, fails, *_), path = min(local, key=lambda item: item[0][0])
        certain, possible = (min(end[k] for end, _ in local) for k in (2, 3))
        results.append(Together(share, path.corner, fails, certain, possible))
    return results


def _search(ways: list[_Way], valid: Good, search: tuple[int, int, int]) -> list[tuple]:
    """(share, attribute that fails, certain, possible) for every segment; all are searched
    together."""
    count, within, times = search
    observed = [{0.0: (True, -1, True, True)} for _ in ways]

    def look(shares: list[np.ndarray]) -> None:
        requested = [(i, float(s)) for i, share in enumerate(shares) for s in share]
        if requested:
            result = valid([ways[i].at(s) for i, s in requested])
            rows = zip(*(item.tolist() for item in result))
            for (i, s), row in zip(requested, rows):
                observed[i][s] = row

    look([np.arange(1, count + 1) / count] * len(ways))
    for _ in range(times):
        brackets = [_bracket(entry) for entry in observed]
        look([np.linspace(a, b, within + 2)[1:-1] if b > a else np.array([]) for a, b in brackets])
    return [_ends(value) for value in observed]


def _bracket(observed: dict[float, tuple]) -> PairEnds:
    """The last share before the first failure, and the share of the failure; equal if none
    fails."""
    last = 0.0
    for share in sorted(observed):
        if not observed[share][0]:
            return last, share
        last = share
    return last, last


def _ends(observed: dict[float, tuple]) -> tuple[float, int, float, float]:
    last, failed = _bracket(observed)
    fails = -1 if failed == last else int(observed[failed][1])
    shares = sorted(observed)
    certain = next((a for a, b in pairwise(shares) if not observed[b][2]), shares[-1])
    possible = next((share for share in shares if not observed[share][3]), shares[-1])
    return last, fails, certain, possible


def _interactions(process: "PharmaProcess", both: Sequence) -> list[tuple]:
    """(interaction [Q], its largest share of a margin, the attribute, whether all corners meet the
    limits)."""
    if not both:
        return []
    rows = [batches.nominally(process, {})]
    for pair in both:
        for corner in CORNERS:
            endpoints = [(p.normal_low, p.normal_high)[sign > 0] for p, sign in zip(pair, corner)]
            changes = {(p.input, p.entry): end for p, end in zip(pair, endpoints)}
            rows.append(batches.nominally(process, changes))
    values = batches.attributes(process, np.concatenate(rows))
    limits = AttributeLimits.of(process.case)
    room = np.where(limits.any(), limits.distance(values[0]), np.nan)
    interactions = []
    for corners in values[1:].reshape(len(both), 4, -1):
        effect = np.array([a * b for a, b in CORNERS]) @ corners / 4
        with np.errstate(divide="ignore", invalid="ignore"):
            used = np.where(room > 0, np.abs(effect) / room, np.nan)
        maximum = int(np.nanargmax(used)) if np.isfinite(used).any() else -1
        largest = float(used[maximum]) if maximum >= 0 else float("nan")
        interactions.append((effect, largest, maximum, bool(limits.hold(corners).all())))
    return interactions
