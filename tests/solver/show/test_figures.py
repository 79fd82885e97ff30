"""A solution in a notebook: tables, and figures whose numbers are those of the solution."""

from dataclasses import replace

import numpy as np
import pytest
from tests.solver.twelve import Swing, policy, problem

import snapo

pytestmark = pytest.mark.prove


@pytest.fixture(scope="module")
def solution() -> snapo.Solution:
    of = problem(Swing)
    training = snapo.Training(steps=4, paths=32, validation_paths=64, validation_every=2)
    few = snapo.Evaluation(paths=512, sensitivity_paths=512, smooth_paths=0)
    return snapo.solve(of, policy=policy(of), training=training, evaluation=few, engine="xla")


def test_a_solution_and_its_table_show_themselves(solution):
    page = solution._repr_html_()
    assert f"{solution.value:,.6g}" in page and page.count("<tr>") == 4
    for name in ("rights", "strike", "sigma"):
        assert f">{name}</td>" in page
    hostile = replace(solution, reason="<script>")
    assert "<script>" not in hostile._repr_html_() and "&lt;script&gt;" in hostile._repr_html_()


def test_the_tornado_shows_the_change_by_a_hundredth(solution):
    (axes,) = solution.plot.tornado().axes
    found = solution.sensitivities
    assert found is not None
    widths = {
        label.get_text(): bar.get_width()
        for label, bar in zip(axes.get_yticklabels(), axes.patches)
    }
    for name, given in found.inputs.items():
        expected = found.held[name].value * 0.01 * given.value
        assert widths[f"{name} +1 %"] == pytest.approx(float(expected), rel=1e-6)
    with pytest.raises(ValueError, match="without sensitivities"):
        replace(solution, sensitivities=None).plot.tornado()


def test_the_histogram_counts_every_path_and_the_history_every_step(solution):
    (axes,) = solution.plot.distribution("value").axes
    assert sum(bar.get_height() for bar in axes.patches) == 512
    with pytest.raises(KeyError, match="no output 'cash'"):
        solution.plot.distribution("cash")
    (axes,) = solution.plot.training().axes
    every, validations = (line.get_xdata() for line in axes.get_lines())
    np.testing.assert_array_equal(every, [1, 2, 3, 4])
    assert set(validations) <= {1, 2, 3, 4} and len(validations)


def test_figures_draw_into_axes_that_are_given(solution):
    from matplotlib.figure import Figure

    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert solution.plot.training(ax=left) is figure
    assert solution.plot.distribution(ax=right) is figure
