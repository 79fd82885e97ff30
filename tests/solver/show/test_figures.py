"""A solution in a notebook: tables, and figures whose numbers are those of the solution."""

from dataclasses import replace

import numpy as np
import pytest
from tests.solver.twelve import Swing, policy, problem

import snapo
from snapo.solver.figures import simulated_series

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
        expected = found.along(name, 0.01 * given.value).value
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
    assert solution.plot.training(ax=left) is None and left.get_lines()
    assert solution.plot.distribution(ax=right) is None and right.patches


def test_a_problem_shows_its_inputs():
    page = problem(Swing)._repr_html_()
    assert page.count("<tr>") == 1 + 3
    for name in ("rights", "strike", "sigma"):
        assert f">{name}</td>" in page


def test_a_fan_holds_nine_tenths_of_the_paths_and_a_policy_is_drawn_against_its_state(solution):
    series = simulated_series(solution.problem, solution.policy)
    name = next(each for each in series if series[each].std() > 0)
    (axes,) = solution.plot.fan(name).axes
    (line,) = axes.get_lines()
    assert np.allclose(line.get_ydata(), series[name].mean(1))
    state = next(each for each in series if len(series[each]) == max(map(len, series.values())))
    (axes,) = solution.plot.policy(state, step=1).axes
    assert np.isfinite(axes.get_lines()[0].get_ydata()).all()
    with pytest.raises(KeyError, match="there is no 'cash'"):
        solution.plot.fan("cash")
    with pytest.raises(ValueError, match="needs a"):
        replace(solution, problem=None).plot.fan(name)


def test_the_workbook_holds_the_numbers_and_their_charts(solution, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    hostile = replace(solution, notes=("=1+1",))
    hostile.write_table(tmp_path / "x.xlsx")
    book = openpyxl.load_workbook(tmp_path / "x.xlsx")
    assert book.sheetnames[:3] == ["result", "sensitivities", "training"]
    found = {row[0].value: row[1] for row in book["result"].iter_rows(2)}
    assert found["value"].value == solution.value
    assert found["notes"].data_type == "s" and found["notes"].value == "=1+1"
    header, *rows = book["sensitivities"].iter_rows(values_only=True)
    assert rows[0][header.index("held")] == next(iter(solution.sensitivities.rows())).held
    total = book["total value"]
    assert sum(row[2] for row in total.iter_rows(2, values_only=True)) == 512
    assert len(book["training"]._charts) == len(total._charts) == 1
    with pytest.raises(ValueError, match=r"ends in \.xlsx"):
        solution.write_table(tmp_path / "x.csv")
