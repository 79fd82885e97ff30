"""The best moves of a step in machine code: the bits of NumPy's loop, which compares all passages."""

import datetime

import numpy as np
import pytest
from tests.domains.energy.energy_cases import battery, plant, swing

from snapo.domains.energy.core.contract import StepPrices
from snapo.domains.energy.methods import ways
from snapo.domains.energy.methods.grid import best, grid_of
from snapo.domains.energy.setup import bare_problem
from snapo.lanes.machine import pipeline

DAYS = {"end": datetime.datetime(2026, 5, 6)}
pytestmark = pytest.mark.skipif(not pipeline.available(), reason="llvmlite is not installed")


@pytest.mark.parametrize(
    ("case", "apart"),
    [(battery(**DAYS), None), (battery(**DAYS), 0.3), (plant(), None), (swing(), None)],
    ids=["battery", "between nodes", "plant", "swing"],
)
def test_machine_code_has_the_bits_of_numpy(case, apart):
    """At prices and values without any structure; columns that the code's width does not divide."""
    layout, schedule = case.contract.layout, bare_problem(case).schedule
    widths = None if apart is None else np.full(len(layout.levels), apart)
    grid, random = grid_of(layout, schedule, apart=widths), np.random.default_rng(0)
    for t in (0, len(grid.steps) // 2, len(grid.steps) - 1):
        step = grid.steps[t]
        nodes = int(np.prod([len(x) for x in step.after], dtype=int))
        for columns in (ways.WIDTH, 2 * ways.WIDTH + 5):
            spot, index = 30 + 20 * random.standard_normal((2, columns))
            prices = StepPrices(spot, index if layout.indexed else None)
            after = random.standard_normal((len(layout.modes), nodes, columns))
            terms = schedule.steps.terms
            numbers = prices.units(terms, t), prices.moves(terms, t), after
            assert step.ways is not None and step.ways.serve(columns)
            np.testing.assert_array_equal(
                best(step, layout, *numbers), best(step._replace(ways=None), layout, *numbers)
            )


def test_few_columns_are_numpys():
    grid = grid_of(battery(**DAYS).contract.layout, bare_problem(battery(**DAYS)).schedule)
    made = grid.steps[0].ways
    assert made is not None and not made.serve(ways.WIDTH - 1) and made.serve(ways.WIDTH)
