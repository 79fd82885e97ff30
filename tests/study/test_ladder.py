"""The order of methods, and their differences path by path."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from snapo.study.chapters import ladder
from snapo.study.chapters.ladder import (
    CommonPaths,
    Estimated,
    MethodLadder,
    ValuationMethod,
    side_by_side,
)

PATHS = 400
EARNED = 10.0 + np.random.default_rng(0).standard_normal(PATHS)


def compared(tmp_path: Path, printed: list[str] | None = None, **values) -> MethodLadder:
    """The ladder of values by the names of constants of the module."""

    def method(key: str, value) -> ValuationMethod:
        def compute():
            if isinstance(value, str):
                raise ValueError(value)
            return value

        return ValuationMethod(getattr(ladder, key), "", compute)

    written: dict[str, list] = {}
    run = SimpleNamespace(
        progress=(printed if printed is not None else []).append,
        write_records=lambda name, kind, records: written.update({name: [kind, *records]}),
    )
    paths = CommonPaths([], EARNED, np.arange(PATHS))
    methods = [method(key, value) for key, value in values.items()]
    result = side_by_side(run, paths, methods)  # pyright: ignore[reportArgumentType]
    (table,) = written.values()
    assert len(table) == len(result.methods) + 1
    return result


def test_paths_are_paired(tmp_path):
    """A method 0.1 below on every path is certainly below, however far the paths are apart."""
    result = compared(tmp_path, POLICY=EARNED, LEAST_SQUARES=EARNED - 0.1, BY_DAY=Estimated(8.0))
    rows = {row.method: row for row in result.methods}
    row = rows[ladder.LEAST_SQUARES]
    assert row.difference == pytest.approx(-0.1) and row.difference_error < 1e-12
    assert row.standard_error == pytest.approx(1 / np.sqrt(PATHS), rel=0.1)
    top = float(EARNED.mean())
    assert row.share == pytest.approx((top - 0.1 - 8.0) / (top - 8.0))
    assert rows[ladder.POLICY].difference is None and rows[ladder.POLICY].share == 1
    assert result.methods[0].method == ladder.BY_DAY


def test_a_wrong_order_is_a_warning(tmp_path):
    printed: list[str] = []
    right = compared(tmp_path, printed, POLICY=EARNED, LATTICE=Estimated(10.2, 0.01))
    assert not right.warnings and not any("warning" in line for line in printed)
    wrong = compared(tmp_path, printed, POLICY=EARNED, UPPER=EARNED - 0.01, BY_DAY=Estimated(10.5))
    assert len(wrong.warnings) == 2
    assert "Trained policy is above upper bound by 0.01" in wrong.warnings[1]
    assert "Intrinsic by day is above trained policy" in wrong.warnings[0]
    assert any(line.startswith("warning: ") for line in printed)


def test_less_than_three_errors_are_no_warning(tmp_path):
    """The mean of the paths is 10 ± 0.05."""
    mean = float(EARNED.mean())
    for excess, warned in ((0.1, False), (0.2, True)):
        result = compared(tmp_path, POLICY=EARNED, LATTICE=Estimated(mean - excess, 0.0))
        assert bool(result.warnings) == warned


def test_a_method_without_a_value_is_named_with_its_reason(tmp_path):
    result = compared(tmp_path, POLICY=EARNED, ROLLING="its prices have spikes")
    assert [row.method for row in result.methods] == [ladder.POLICY]
    assert result.missing[0] == ladder.MissingMethod(ladder.ROLLING, "its prices have spikes")
