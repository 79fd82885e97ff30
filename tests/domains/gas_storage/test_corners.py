"""A store whose daily volumes divide its room: the value of gas has corners, and two slopes there."""

import datetime
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, changed, read

from snapo.domains.gas_storage.references.intrinsic import values_after
from snapo.domains.gas_storage.references.lattice import lattice
from snapo.domains.gas_storage.references.marginal import PIECES, marginal_values, slope_table
from snapo.domains.gas_storage.setup import bare_problem, factors, fitted_value, make_setup
from snapo.solver.evaluate import evaluate

DAYS, FIRST, ROOM, RATE = 60, datetime.date(2025, 1, 1), 400.0, 50.0
WEEKEND, WAVE = 5, 9.0


def weekdays(i: int) -> float:
    return 20.0 - (i % 7 >= WEEKEND)


def wave(i: int) -> float:
    return 25 + 2 * math.sin(i / WAVE)


def corners(folder: Path, price=weekdays, volatility: float = 0.3, reversion=12.0, **contract):
    """Eight days fill the store and eight empty it; every day is one that may."""
    place = Path(shutil.copytree(CASES / "quick", folder / "case"))
    days = [FIRST + datetime.timedelta(i) for i in range(DAYS)]
    rows = [f"{day},{price(i)}\n" for i, day in enumerate(days)]
    (place / "curve.csv").write_text("date,price\n" + "".join(rows))
    plain = {
        "end": FIRST + datetime.timedelta(DAYS), "inventory": 0.0, "max_inventory": ROOM,
        "max_injection": RATE, "max_withdrawal": RATE, "injection_cost": 0.0,
        "withdrawal_cost": 0.0,
    }  # fmt: skip
    model = {"mean_reversion": reversion, "volatility": volatility}
    return changed(place, contract=plain | contract, model=model)


def test_without_noise_the_table_has_the_slopes_of_both_sides(tmp_path):
    """Against the exact piecewise-linear values: a slope above and another one below a corner."""
    schedule = bare_problem(corners(tmp_path)).schedule
    found, steps = marginal_values(schedule, None, "linear"), schedule.steps
    low = np.append(steps.low, steps.next_low[-1:])
    high = np.append(steps.high, steps.next_high[-1:])
    two_sided = 0
    for t, line in enumerate(values_after(schedule, "linear", low, high)):
        if high[t + 1] <= low[t + 1]:
            continue
        row = np.linspace(found.low[t], found.high[t], found.above.shape[1])
        inside = (row > low[t + 1] + 1) & (row < high[t + 1] - 1)
        above, below = ((line(row + d) - line(row)) / d for d in (0.01, -0.01))
        np.testing.assert_allclose(found.above[t, inside, 0], above[inside], atol=1e-8)
        np.testing.assert_allclose(found.below[t, inside, 0], below[inside], atol=1e-8)
        two_sided += np.count_nonzero(below[inside] - above[inside] > 0.1)
    assert two_sided > 20


@pytest.mark.parametrize(
    ("contract", "step"),
    [
        ({}, RATE),
        ({"max_withdrawal": 100.0}, RATE),
        ({"max_injection": 50.5}, 50.25),  # a rate that was moved a little
        ({"max_injection": 20.0, "max_withdrawal": 30.0, "max_inventory": 100.0}, 10.0),
        ({"max_injection": 200.0, "max_withdrawal": 200.0}, 200.0 / 5),
        ({"max_injection": 1.0}, None),  # too many corners for a table
        ({"inventory_loss": 0.001}, None),
    ],
)
def test_rows_lie_on_corners_where_these_are_few(tmp_path, contract, step):
    table = slope_table(bare_problem(corners(tmp_path, **contract)).schedule)
    assert table.corners == (step is not None)
    if step is not None:
        levels = (table.high - table.low) / PIECES
        np.testing.assert_allclose(levels, step, rtol=0.01)
        np.testing.assert_allclose(table.low / step, np.round(table.low / step), atol=0.05)
    assert np.all(table.low <= table.next_low + 3) and np.all(table.high >= table.next_high - 3)


def test_three_exercises_have_rows_on_their_corners():
    """G4: 1,200, 800 and 900 of 2,900 are multiples of 100, an eighth of the least of them."""
    table = slope_table(bare_problem(read("G4")).schedule)
    assert table.corners and table.segments == 2 * PIECES
    np.testing.assert_allclose((table.high - table.low) / table.segments, 100.0)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("price", "model"), [(weekdays, (0.3, 12.0)), (wave, (0.9, 20.0))], ids=["weekdays", "wave"]
)
def test_the_rule_of_the_value_table_is_near_the_exact_value(tmp_path, price, model):
    """Slopes of both sides mixed gave away 0.98 % and 0.22 % of these values."""
    case = corners(tmp_path, price, *model)
    problem = bare_problem(case)
    exact = lattice(problem.schedule, factors(problem), "linear").value
    setup = make_setup(case, "native", fitted_value(problem))
    rule = evaluate(
        setup.problem, setup.policy.value_rule, paths=16384, engine=setup.engines.evaluate
    )
    assert exact * 0.998 < rule.value < exact + 4 * rule.standard_error
