"""Proven ranges: of one parameter at a time, and of two together."""

from snapo.report.folder import RunFiles
from snapo.report.page import Block, Mark, Missing, Table
from snapo.report.quantity import SPACE, finite, number, percent, quantity, with_unit
from snapo.study.chapter import Chapter
from snapo.study.study import StudyRun

from ..quality import pairs, ranges
from ..quality.pairs import Pair, Together
from ..quality.ranges import AcceptableRange, ProvenRange
from ..quality.records import Parameter
from ..shared import MESH, open_loop, sampled
from .model import Statement, location, stated

SAMPLES = 128
SHOWN = 15  # pairs in the report, those with the least room first


def measure(run: StudyRun) -> tuple[ProvenRange, ...]:
    """Both proven ranges of every parameter."""
    complete = sampled(run)
    space = complete.case.design_space
    assert space is not None
    return tuple(ranges.proven_ranges(complete, space.required, SAMPLES, open_loop(run).seed))


def measure_pairs(run: StudyRun) -> tuple[Pair, ...]:
    """The proven ranges of every two parameters together."""
    complete, proven = sampled(run), RANGES.of(run)
    space = complete.case.design_space
    assert space is not None and proven is not None
    parameters = {x.name: x for x in complete.case.parameters}
    nominal = {x.parameter: _ends(parameters[x.parameter], x.nominal) for x in proven}
    probable = {x.parameter: _ends(parameters[x.parameter], x.probable) for x in proven}
    seed = open_loop(run).seed
    return tuple(pairs.pairs(complete, nominal, probable, space.required, SAMPLES, seed))


def _ends(parameter: Parameter, proven: AcceptableRange) -> tuple[float, float] | None:
    """The ends of a range in the domain's unit; None if even the set point fails."""
    if proven.low is None or proven.high is None:
        return None
    scale, offset = parameter.scale, parameter.offset
    return scale * proven.low + offset, scale * proven.high + offset


def show(run: RunFiles, result: tuple[ProvenRange, ...]) -> list[Block]:
    """Proven acceptable ranges one at a time, and whether normal operation stays inside."""
    normal = {x.name: x.normal for x in stated(run).parameters}
    if not result:
        return [Missing("The case has no parameters.")]
    rows = [
        (
            with_unit(x.parameter, x.unit), _edges(x.nominal), _edges(x.probable),
            _verdict(x.probable), _span(normal.get(x.parameter, ())), _range(x.nominal),
            _range(x.probable), _span(x.probable.certain), _span(x.probable.possible),
        )
        for x in result
    ]  # fmt: skip
    required = percent(result[0].required, 0)
    names = ("Parameter", "Edge, nominal model", f"Edge, at {required}", "Normal range",
             "Normal range", "Nominal model", f"Probability {required}", f"certain at 95{SPACE}%",
             f"possible at 95{SPACE}%")  # fmt: skip
    caption = (
        "The range of one parameter with all others at their set point: for the model with its "
        "nominal numbers, and with the required probability under all variation "
        f"({number(result[0].samples, 0)} batches per point). The columns “Edge, …” name "
        "the attribute that fails beyond the range, or show “studied range” if none fails. A range "
        "is certain while the lower end of the 95 % interval of the probability is at least the "
        "required probability, and possible while the upper end is."
    )
    return [Table([(name, "") for name in names], rows, caption, 4)]


def _verdict(proven: AcceptableRange) -> Mark:
    if not proven.holds_normal:
        return Mark(False, "not inside")
    return Mark(proven.sure_normal, "inside" if proven.sure_normal else "inside, not certain")


def _span(endpoints: tuple[float, ...] | None) -> str:
    return "–" if endpoints is None else " – ".join(map(location, endpoints))


def _range(proven: AcceptableRange) -> str:
    if proven.low is None:
        return "set point fails"
    return f"{location(proven.low)} – {location(proven.high)}"


def _edges(proven: AcceptableRange) -> str:
    if proven.low is None:
        return proven.low_edge or "set point fails"
    low, high = (edge or "studied range" for edge in (proven.low_edge, proven.high_edge))
    return low if low == high else f"{low} | {high}"


def show_pairs(run: RunFiles, result: tuple[Pair, ...]) -> list[Block]:
    """Proven ranges of two parameters at once."""
    if not result:
        return [Missing("There is only one parameter, so there are no pairs.")]
    order = sorted(result, key=lambda pair: (_least(pair), -(finite(pair.used) or 0.0)))
    names, case = stated(run).attribute_names, stated(run)
    rows = [
        (
            " and ".join(pair.names), _share(pair.nominal), _corner(pair, names),
            _share(pair.probable), _sure(pair.probable),
            Mark(pair.holds_normal, "keep" if pair.holds_normal else "break"),
            _interaction(case, pair),
        )
        for pair in order[:SHOWN]
    ]  # fmt: skip
    head = ("Parameters", "Share of both, nominal model", "Corner that fails first",
            "With the required probability", "certain – possible at 95 %",
            "Corners of normal ranges", "Interaction")  # fmt: skip
    caption = (
        "A proven range holds with all other parameters at their set point. Here two parameters "
        "move together, from the set point to each of the four corners of their proven ranges. "
        "The share of both is the largest share of both ranges at which no corner breaks a limit "
        "(100 %: the ranges may be used together). The interaction is half of the difference "
        "between the effects of one parameter at both ends of the other's normal range, in the "
        "attribute whose margin it uses most."
    )
    if len(result) > SHOWN:
        caption += f" Shown are the {SHOWN} of {len(result)} pairs with the smallest shares."
    return [Table([(name, "") for name in head], rows, caption, frozenset({0, 2, 5, 6}))]


def _least(pair: Pair) -> float:
    return min((x.share for x in (pair.nominal, pair.probable) if x is not None), default=2.0)


def _share(together: Together | None) -> str:
    return "–" if together is None else percent(together.share, 0)


def _sure(together: Together | None) -> str:
    if together is None:
        return "–"
    return f"{percent(together.certain, 0)} – {percent(together.possible, 0)}"


def _corner(pair: Pair, names: list[str]) -> str:
    """The corner of the nominal ranges that fails first, and the attribute that fails there."""
    together = pair.nominal
    if together is None or together.fails < 0:
        return "–"
    sides = [
        f"{name} {'high' if side > 0 else 'low'}" for name, side in zip(pair.names, together.corner)
    ]
    return f"{', '.join(sides)}: {names[together.fails]}"


def _interaction(case: Statement, pair: Pair) -> str:
    if pair.maximum < 0:
        return "–"
    attribute, effect = case.attributes[pair.maximum], pair.interaction[pair.maximum]
    if not effect:
        return "none"
    size = quantity(effect, attribute.shown_unit)
    return f"{attribute.name} {size}, {percent(pair.used)} of its margin"


RANGES = Chapter(
    "proven ranges", "Proven acceptable ranges and edge of failure", tuple[ProvenRange, ...],
    measure, show, "Ranges", needs=(MESH,), key="ranges", table="design_space"
)  # fmt: skip
PAIRS = Chapter(
    "pairs of ranges", "Proven ranges of two parameters at once", tuple[Pair, ...],
    measure_pairs, show_pairs, "Pairs", needs=(RANGES.name,), key="pairs", table="design_space"
)  # fmt: skip
