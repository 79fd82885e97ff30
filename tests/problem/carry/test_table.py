"""Decisions over two observed numbers: each is the policy's own, in rows and in the CSV."""

import csv

import numpy as np
import pytest

import snapo

RULE = snapo.Linear(np.array([[1.0, 10.0, 100.0]]), 0.5)
X, Y = [0.0, 1.0], [2.0, 3.0, 4.0]


def test_rows_are_the_policy_s_decisions(tmp_path):
    file = tmp_path / "table.csv"
    found = snapo.decision_table(RULE, file, x=(2, X), y=(0, Y), at=[9, 1, 9])
    expected = [[c, a, a + 10 + 100 * c + 0.5] for c in X for a in Y]
    np.testing.assert_allclose(np.concatenate(found, axis=1), expected, rtol=1e-15)
    with file.open() as stream:
        head, *rows = csv.reader(stream)
    assert head == ["observation 2", "observation 0", "action 0"]
    np.testing.assert_array_equal(np.array(rows, float), np.concatenate(found, axis=1))


def test_raw_numbers_are_observed_first():
    found = snapo.decision_table(
        RULE, x=(0, [50.0, 70.0]), y=(1, [0.0]), at=[0, 0], observe=lambda raw: np.array([0.05, 0, 0]) * (raw[0] - 50)
    )  # fmt: skip
    np.testing.assert_allclose(found.action[:, 0], [0.5, 1.5], rtol=1e-12)


@pytest.mark.parametrize("x, y", [(0, 0), (0, 3), (-1, 1)])
def test_numbers_that_do_not_exist_are_refused(x, y):
    with pytest.raises(ValueError, match="two different numbers from 0 to 2"):
        snapo.decision_table(RULE, x=(x, X), y=(y, Y), at=[0, 0, 0])
