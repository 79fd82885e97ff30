"""Probabilities, ranges and capability against normal closed forms of a process that is linear."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr
from tests.domains.pharma.pharma_cases import Polynomial, template

from snapo.domains.pharma.chapters.sensitivities import criticality
from snapo.domains.pharma.derivatives import sensitivities
from snapo.domains.pharma.derivatives.jacobian import Jacobian
from snapo.domains.pharma.quality import boundary, capability, design_space, draws, ranges

GROWTH, T2, T_F = (
    ("crystalliser.kinetics.growth", 0),
    ("crystalliser.temperature", 2),
    ("crystalliser.temperature", 3),
)
SPREAD, SAMPLES, SEED = 0.3, 4000, 7


def attributes(low=None, high=None):
    """One attribute with a limit that binds, one with a wide one."""
    return [
        {"name": "first", "measure": "crystalliser.d43", "unit": "um", "citation": "own"}
        | ({"low": f"{low} um"} if low is not None else {})
        | ({"high": f"{high} um"} if high is not None else {}),
        {"name": "second", "measure": "filter.time", "unit": "s", "citation": "own",
         "high": "1e6 s"},
    ]  # fmt: skip


def parameter(name, of, low, high, normal):
    return {
        "name": name, "of": of, "range": [f"{low} K", f"{high} K"],
        "normal": [f"{x} K" for x in normal], "source": "made up",
        "distribution": {"kind": "normal", "spread": f"{SPREAD} K"},
    }  # fmt: skip


PARAMETERS = [
    parameter("T2", "crystalliser.temperature[2]", 290, 300, (294, 296)),
    parameter("T_f", "crystalliser.temperature[3]", 273.15, 283.15, (277.15, 279.15)),
]


@pytest.fixture(scope="module")
def linear():
    """first = 100 + 2 (T2 - 295) - 1 (T_f - 278.15), required above 97; z only through spreads."""
    case = template(
        attributes=attributes(low=97), parameters=PARAMETERS, uncertainty=None, pairs=None,
        design_space={"axes": ["T2", "T_f"], "points": 9, "samples": SAMPLES, "required": 0.9},
    )  # fmt: skip
    return Polynomial(case, [100, 5], {T2: np.array([2, 0.0]), T_F: np.array([-1, 0.0])})


def exact(t2, t_f):
    mean = 100 + 2 * (t2 - 295) - (t_f - 278.15)
    return ndtr((mean - 97) / (SPREAD * np.sqrt(5)))


def test_the_map_is_the_normal_probability(linear):
    found = design_space.probability_map(linear, SEED)
    grid = np.meshgrid(*found.grid, indexing="ij")
    truth = exact(*grid)
    allowed = 4 * np.sqrt(np.maximum(truth * (1 - truth), 1e-4) / SAMPLES) + 1e-9
    assert (np.abs(found.at.probability - truth) < allowed).all()
    p = found.at.probability
    # Binomial, and above zero where no draw, or every draw, broke a limit.
    middle = (p > 0.05) & (p < 0.95)
    binomial = np.sqrt(p * (1 - p) / SAMPLES)
    assert found.at.error[middle] == pytest.approx(binomial[middle], rel=0.01)
    assert (found.at.error > 0).all()
    assert set(np.unique(found.at.binding)) <= {-1, 0}
    assert (found.at.binding[p < 1] == 0).all()
    assert found.at.mean[4, 4, 0] == pytest.approx(100, abs=0.1)
    assert found.at.by_attribute[..., 1].min() == 1


def test_the_edge_lies_where_the_closed_form_has_it(linear):
    """P = 0.9 at mean = 97 + 1.2816 sqrt(5) 0.3 for T2 alone."""
    found = ranges.proven_ranges(linear, 0.9, SAMPLES, SEED)[0]
    assert found.nominal.low == pytest.approx(293.5, abs=10 / 16 / 512)
    assert (found.nominal.low_edge, found.nominal.high_edge) == ("first", "")
    assert found.nominal.high == 300
    edge = 295 + (97 - 100 + 1.2816 * SPREAD * np.sqrt(5)) / 2
    assert found.probable.low == pytest.approx(edge, abs=10 / 8 / 4)
    assert found.probable.holds_normal is False or found.probable.low <= 294
    assert found.unit == "K"


def test_edges_and_contours_have_intervals(linear):
    """The edge lies between the end of what is sure and the end of what is possible, and both
    close in on it with more draws; a share of one is not sure to be one."""
    truth = 295 + (97 - 100 + 1.2816 * SPREAD * np.sqrt(5)) / 2
    widths = []
    for samples in (128, 2048):
        found = ranges.proven_ranges(linear, 0.9, samples, SEED)[0].probable
        assert found.certain is not None and found.possible is not None
        assert found.possible[0] <= truth <= found.certain[0]
        assert found.certain[0] >= found.low >= found.possible[0]
        widths.append(found.certain[0] - found.possible[0])
    assert widths[1] <= widths[0]
    at = design_space.at_points(linear, [{}], 128, SEED)
    assert at.probability[0] == 1 and at.high[0] == 1
    assert at.low[0] == pytest.approx(1 / (1 + 1.959964**2 / 128))
    assert boundary.draws_for(0.99) == 381


def test_intervals_of_shares_cover():
    """Wilson's interval holds the probability in 95 % of the samples, give or take 3 errors."""
    rng = np.random.default_rng(0)
    for truth in (0.5, 0.9, 0.97):
        low, high = boundary.interval(rng.binomial(400, truth, 4000) / 400, 400)
        held = ((low <= truth) & (truth <= high)).mean()
        assert abs(held - 0.95) < 0.02


def test_uncertain_kinetics_are_apart_from_batches_that_differ():
    """first = 100 + 2 (T2 - 295) + 1e6 growth: only T2 differs between batches."""
    uncertain = [{"of": "crystalliser.kinetics.growth",
                  "distribution": {"kind": "normal", "spread": "1 um/s"}}]  # fmt: skip
    case = template(attributes=attributes(low=97), parameters=PARAMETERS, uncertainty=uncertain,
                    pairs=None, design_space=None)  # fmt: skip
    slope = {T2: np.array([2, 0.0]), GROWTH: np.array([1e6, 0.0])}
    process = Polynomial(case, [100, 5], slope)
    found = capability.capability(process, 20000, SEED)
    batches, both = 2 * SPREAD, np.hypot(2 * SPREAD, 1)
    assert found.cpk[0] == pytest.approx(3 / (3 * both), rel=0.03)
    assert found.cpk_batches[0] == pytest.approx(3 / (3 * batches), rel=0.25)
    # 90 % of the worlds have a mean within 1.645 of the nominal.
    assert found.cpk_low[0] == pytest.approx((3 - 1.645) / (3 * batches), rel=0.4)
    assert found.cpk_high[0] == pytest.approx((3 + 1.645) / (3 * batches), rel=0.4)
    between = template(attributes=attributes(low=97), parameters=PARAMETERS, pairs=None,
                       uncertainty=[uncertain[0] | {"between_batches": True}],
                       design_space=None)  # fmt: skip
    same = capability.capability(Polynomial(between, [100, 5], slope), 2000, SEED)
    assert same.cpk_batches[0] == pytest.approx(3 / (3 * both), rel=0.25)
    assert np.isnan(same.cpk_low[0])


def test_criticality_is_half_the_change_over_the_room():
    """first = 100 + 2 x + x^2 / 2, x = T2 - 295 K: of a room of 3, T2 over 294 to 296 K uses 2/3 of it."""
    case = template(attributes=attributes(low=97), parameters=PARAMETERS, pairs=None,
                    uncertainty=None, design_space=None)  # fmt: skip
    bent = Polynomial(case, [100, 5], {T2: np.array([2, 0.0]), T_F: np.array([-1, 0.0])},
                      {T2: np.array([0.5, 0.0])})  # fmt: skip
    found = criticality(bent, SEED, 4000)
    assert found.change[0] == pytest.approx([2, -1])
    assert found.share[0] == pytest.approx([2 / 3, 1 / 3])
    # (f(x + 1) - f(x - 1)) / 2 = 2 + x about a point x that is off by 0.3 K.
    wide = 1.645 * SPREAD
    assert [found.low[0, 0], found.high[0, 0]] == pytest.approx([2 - wide, 2 + wide], abs=0.03)
    assert found.share_low[0, 0] == pytest.approx((2 - wide) / 3, abs=0.01)
    assert (found.share[1] == 0).all()


def test_a_set_point_that_fails_has_no_range(linear):
    spoilt = Polynomial(linear.case, [90, 5], linear.slope)
    found = ranges.proven_ranges(spoilt, 0.9, 64, SEED)[0].nominal
    assert (found.low, found.high, found.low_edge, found.holds_normal) == (
        None,
        None,
        "first",
        False,
    )


def test_the_range_stops_at_the_first_gap():
    """A parabola that dips below its limit away from the set point, and rises again."""
    case = template(attributes=attributes(high=101), parameters=PARAMETERS, uncertainty=None,
                    design_space=None)  # fmt: skip
    bump = Polynomial(case, [100, 5], {T2: np.array([1.6, 0.0])}, {T2: np.array([-0.4, 0.0])})
    found = ranges.proven_ranges(bump, 0.9, 64, SEED)[0].nominal
    # 1.6 x - 0.4 x^2 = 1 first at x = 2 - sqrt(1.5); beyond 2 + sqrt(1.5) it would hold again.
    assert found.high == pytest.approx(295 + 2 - np.sqrt(1.5), abs=0.02)
    assert found.low == 290


def test_the_largest_box_is_the_best_of_all():
    rng = np.random.default_rng(3)
    grid = (np.linspace(0, 1, 7), np.linspace(0, 2, 6))
    probability = rng.choice([0.5, 1.0], (7, 6), p=[0.2, 0.8])
    probability[2:4, 2:4] = 1
    nothing = np.zeros((7, 6))
    at = design_space.Point(probability, *[nothing] * 7)
    found = design_space.largest_box(
        design_space.ProbabilityMap(("a", "b"), grid, at, 1), (0.4, 0.9), 0.9
    )
    best = 0.0
    for i in range(3):
        for j in range(3, 7):
            for k in range(3):
                for m in range(3, 6):
                    if (probability[i : j + 1, k : m + 1] == 1).all():
                        best = max(best, (j - i) / 6 * (m - k) / 5)
    assert found is not None and found.volume == pytest.approx(best)
    assert (found.low <= [0.4, 0.9]).all() and (found.high >= [0.4, 0.9]).all()
    bad = at._replace(probability=np.zeros((7, 6)))
    assert (
        design_space.largest_box(
            design_space.ProbabilityMap(("a", "b"), grid, bad, 1), (0.4, 0.9), 0.9
        )
        is None
    )


def test_capability_of_a_normal_attribute(linear):
    found = capability.capability(linear, 20000, SEED)
    sigma = SPREAD * np.sqrt(5)
    assert found.deviation[0] == pytest.approx(sigma, rel=0.02)
    assert found.cpk[0] == pytest.approx(3 / (3 * sigma), rel=0.02)
    truth = 1 - ndtr(3 / sigma)
    assert abs(found.outside[0] - truth) < 4 * np.sqrt(truth / 20000)
    assert found.joint == found.outside[0] and found.failed == 0
    assert found.outside[1] == 0


def test_broken_runs_count_as_failures(linear):
    values = np.array([[100, 5], [np.nan, np.nan], [100.5, 5], [99, 5.0]])
    found = capability.from_values(linear.case, values)
    assert (found.failed, found.joint) == (1, 0.25)
    assert found.mean[0] == pytest.approx(np.mean([100, 100.5, 99]))


def test_draws_have_their_moments_and_do_not_depend_on_their_number():
    data = {"of": "kinetics.prefactor", "distribution": {"kind": "lognormal", "spread": 0.1}}
    other = {"of": "crystalliser.kinetics.growth",
             "distribution": {"kind": "uniform", "spread": "1 um/s"}}  # fmt: skip
    names = ["kinetics.prefactor[product]", "crystalliser.kinetics.growth"]
    case = template(uncertainty=[data, other],
                    correlations=[{"between": names, "value": 0.6}])  # fmt: skip
    found = draws.draw(case, 40000, SEED)
    centre = draws.nominal(case, draws.entries(case))
    assert found.mean(0) == pytest.approx(centre, rel=3e-3)
    sigma = [draws.deviation(d, x) for d, x in zip(case.uncertainty.distributions, centre)]
    assert found.std(0) == pytest.approx(sigma, rel=0.02)
    assert (draws.draw(case, 100, SEED) == found[:100]).all()
    assert draws.entries(case)[2] == GROWTH
    low, high = found[:, 2].min(), found[:, 2].max()
    assert low >= 4e-6 and high <= 6e-6
    # Of a uniform and a lognormal through correlated normals: close to the normals' correlation.
    assert np.corrcoef(found[:, 0], found[:, 2])[0, 1] == pytest.approx(0.6, abs=0.03)
    assert abs(np.corrcoef(found[:, 0], found[:, 1])[0, 1]) < 0.02


def test_the_three_forms_of_a_matrix(linear):
    found = Jacobian(np.array([100.0, 5]), np.array([[2.0, -1], [0, 0]]), "forward", "", 2)
    forms = sensitivities.table(linear.case, found)
    assert (forms.raw == found.jacobian).all()
    assert forms.scaled == pytest.approx(found.jacobian)  # half the normal range is 1 K
    assert forms.share[0] == pytest.approx([2 / 3, -1 / 3])
    assert (forms.zero == [[False, False], [True, True]]).all()
    part = sensitivities.spread(linear.case, np.array([[2.0, -1], [0, 0]]))
    ranks = sensitivities.ranking(linear.case, forms, found, part)
    assert [rank.parameter for rank in ranks] == ["T2", "T_f"]
    left = 3 - 2 * SPREAD * np.sqrt(5)  # of a room of 3, less two standard deviations
    assert ranks[0].share == pytest.approx(2 / left) and ranks[0].attribute == "first"
    assert [rank.variance for rank in ranks] == pytest.approx([0.8, 0.2])
    wide = replace(part, total=np.array([1.6, 0.0]))
    spent = sensitivities.ranking(linear.case, forms, found, wide)
    assert spent[0].spent and not spent[0].outside and spent[0].parameter == "T2"
    assert part.total == pytest.approx([SPREAD * np.sqrt(5), 0])
    assert part.sources == ("T2", "T_f")
    out = found._replace(values=np.array([90.0, 5]))
    beyond = sensitivities.table(linear.case, out)
    assert np.isinf(beyond.share[0]).all()
    assert sensitivities.ranking(linear.case, beyond, out, part)[0].outside
