"""Where a design space ends, and ranges of two parameters at once, against normal closed forms."""

import numpy as np
import pytest
from scipy.special import ndtr
from tests.domains.pharma.pharma_cases import Polynomial, template
from tests.domains.pharma.quality.test_design_space import (
    PARAMETERS,
    SPREAD,
    T2,
    T_F,
    attributes,
)

from snapo.domains.pharma.quality import design_space
from snapo.domains.pharma.quality.boundary import boundaries
from snapo.domains.pharma.quality.pairs import pairs
from snapo.domains.pharma.quality.ranges import proven_ranges

Z = 1.2815515655446004  # of a normal probability of 0.9
SIGMA = SPREAD * np.sqrt(5)  # of first = 100 + 2 (T2 - 295) - (T_f - 278.15), above 97


def linear(samples=400, points=5, **changes):
    space = {"axes": ["T2", "T_f"], "points": points, "samples": samples, "required": 0.9}
    case = template(
        attributes=attributes(low=97), parameters=PARAMETERS, uncertainty=None, pairs=None,
        design_space=space | changes,
    )  # fmt: skip
    return Polynomial(case, [100, 5], {T2: np.array([2, 0.0]), T_F: np.array([-1, 0.0])})


def test_the_boundary_is_that_of_the_normal_probability():
    """2 (T2 - 295) = -3 + (T_f - 278.15) + z sigma, within 4 standard errors. The interval reaches
    1.96 of them, sqrt(p (1 - p) / n) / P', to either side; how often it holds is tested below."""
    truth = 295 + (-3 + Z * SIGMA) / 2
    slope = 2 / SIGMA * np.exp(-Z * Z / 2) / np.sqrt(2 * np.pi)  # dP/dT2 there
    for samples in (400, 3200):
        found = design_space.probability_map(linear(samples), 7)
        middle = [each for each in found.boundaries if each.at == (-1, 2)]  # T_f at its set point
        assert len(middle) == 1 and middle[0].side == -1 and middle[0].binding == 0
        end = middle[0]
        assert end.outer < end.position < end.inner
        half = 1.959964 * np.sqrt(0.09 / samples) / slope
        assert (end.inner - end.outer) / 2 == pytest.approx(half, rel=0.25)
        assert end.position == pytest.approx(truth, abs=4 / 1.96 * half)
    across = [each for each in found.boundaries if each.axis == 1]
    assert {each.side for each in across} == {1}  # T_f lowers it: the space ends upwards


def test_the_interval_of_the_boundary_covers():
    """In 95 % of the samples, give or take three errors of 400 of them."""
    rng, grid = np.random.default_rng(1), np.linspace(-1.0, 3.0, 9)
    held = []
    for _ in range(400):
        rooms = (grid[:, None] + rng.normal(size=200))[:, :, None]
        (end,) = boundaries(rooms, [grid], 0.9)
        held.append(end.outer <= Z <= end.inner and end.side == -1)
    assert abs(np.mean(held) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 400)


def test_lines_that_are_good_or_bad_throughout_have_no_end():
    rooms = np.ones((4, 3, 50, 1))
    grid = [np.arange(4.0), np.arange(3.0)]
    assert not boundaries(rooms, grid, 0.9) and not boundaries(-rooms, grid, 0.9)
    rooms[3] = -1.0  # the last row of the first axis fails, between 2 and 3 at 2.5
    found = boundaries(rooms, grid, 0.9)
    assert [each.at for each in found] == [(-1, 0), (-1, 1), (-1, 2)]
    assert all(each.side == 1 and each.position == pytest.approx(2.5, abs=0.02) for each in found)
    few = boundaries(rooms[:, :, :5], grid, 0.9)  # five draws make nothing sure
    assert all(np.isnan(each.inner) for each in few)


def of(proven, which):
    own = {each.parameter: getattr(each, which) for each in proven}
    return {name: None if each.low is None else (each.low, each.high) for name, each in own.items()}


def test_two_ranges_together():
    """T2 alone may fall by 1.5 K and T_f alone rise by 3 K; both at once by half of that each. With
    a probability of 0.9 it is half of (3 - z sigma) / 2 and of 3 - z sigma as well."""
    process = linear()
    proven = proven_ranges(process, 0.9, 4000, 7)
    ranges = of(proven, "nominal"), of(proven, "probable")
    (found,) = pairs(process, *ranges, 0.9, 4000, 7)
    assert found.names == ("T2", "T_f") and found.nominal and found.probable
    assert found.nominal.share == pytest.approx(0.5, abs=0.02)
    assert (found.nominal.corner, found.nominal.fails) == ((-1, 1), 0)
    assert found.probable.share == pytest.approx(0.5, abs=0.08)
    assert found.probable.certain <= found.probable.share <= found.probable.possible
    edge = ranges[1]["T2"]
    assert edge is not None and ndtr((100 + 2 * (edge[0] - 295) - 97) / SIGMA) >= 0.88
    # At the corner of the normal ranges, 1 K to either side, nothing is left: 100 - 2 - 1 = 97.
    assert found.holds_normal and np.allclose(found.interaction, 0, atol=1e-12)


class Crossed(Polynomial):
    """With 0.3 (T2 - 295) (T_f - 278.15) in the first attribute."""

    def batch(self, entries, draws, sensitivities=(), chunk=512):
        found = super().batch(entries, draws, sensitivities, chunk)
        x, y = (np.asarray(draws)[:, list(entries).index(each)] for each in (T2, T_F))
        found.values[:, 0] += 0.3 * (x - self.inputs[T2[0]][T2[1]]) * (y - 278.15)
        return found


def test_an_interaction_is_the_product_of_half_the_ranges():
    """c x y: 0.3 times 1 K times 1 K, of a room of 3."""
    plain = linear()
    process = Crossed(plain.case, plain.constant, plain.slope)
    nothing = {"T2": None, "T_f": None}
    (found,) = pairs(process, nothing, nothing, 0.9, 16, 7)
    assert found.nominal is None and found.probable is None
    assert found.interaction == pytest.approx([0.3, 0])
    assert (found.used, found.maximum) == (pytest.approx(0.1), 0)
    assert not found.holds_normal  # 100 - 2 - 1 - 0.3 is below 97
