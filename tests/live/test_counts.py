"""The page takes as many paths as the run's own error says that its value needs."""

from types import SimpleNamespace

import pytest

from snapo.live.rollout import ENOUGH, FEWEST, MAXIMUM, PathCounts


@pytest.mark.parametrize(
    ("error", "paths", "wanted"),
    [
        (0.00003, 65536, FEWEST),  # the surprises of a fitted value explain nearly all
        (0.0003, 65536, 4096),  # a quarter of the error, a sixteenth of the paths
        (0.1, 65536, MAXIMUM),
        (0.1, 1000, 1000),  # no more than the run had
        (float("nan"), 65536, FEWEST),
    ],
)
def test_paths_of_the_value(error, paths, wanted):
    solution = SimpleNamespace(value=-2.0, standard_error=2.0 * error)
    evaluation = SimpleNamespace(paths=paths, sensitivity_paths=min(paths, 768))
    found = PathCounts.enough(solution, evaluation)
    assert found.value == wanted and found.deltas == min(paths, 768)
    if FEWEST < found.value < MAXIMUM:
        assert error * (paths / found.value) ** 0.5 <= ENOUGH


@pytest.mark.parametrize(
    ("numbers", "wanted"),
    [(100, MAXIMUM), (5_000, 7680), (20_000, 2000 // 512 * 512), (10**6, FEWEST)],
)
def test_a_long_and_wide_course_has_fewer_paths(numbers, wanted):
    solution = SimpleNamespace(value=1.0, standard_error=0.1)
    evaluation = SimpleNamespace(paths=65536, sensitivity_paths=16384)
    assert PathCounts.enough(solution, evaluation, numbers).value == wanted


def test_paths_that_are_asked_for_are_taken():
    assert PathCounts.of(65536).value == 65536
    assert PathCounts.of(100) == (100, 100, 100)
