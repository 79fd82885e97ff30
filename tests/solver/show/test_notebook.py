"""Solutions and their pictures in a notebook: shown once, as pictures, and as `print` shows them."""

import numpy as np
import pytest

import snapo
from snapo.solver.derivatives.interval import Curvature, Reported
from snapo.solver.figures import Figures
from snapo.solver.statistics import Estimate

RNG = np.random.default_rng(0)
PLOTS = Figures(None, {"cash": RNG.normal(size=64)}, (), None, None)


def test_a_picture_draws_itself_without_a_backend():
    formatter = pytest.importorskip("IPython.core.formatters").DisplayFormatter()
    data, _ = formatter.format(PLOTS.distribution())
    assert data["image/png"].startswith(b"\x89PNG") and "<Figure" not in data["text/plain"]


def estimate(*shape):
    return Estimate(RNG.normal(size=(32, *shape)))


def test_repr_is_what_print_shows():
    numbers = estimate(5)
    reported = Reported(
        "held", numbers, np.ones(5), numbers.blocks.sum(1), np.zeros(5), np.zeros((0, 5)),
        np.zeros((0, 5)), Curvature.nothing(),
    )  # fmt: skip
    inputs = {"price": snapo.Input(np.ones(5)), "cost": snapo.Input(np.ones(5))}
    held = {"price": numbers, "cost": estimate(5)}
    table = snapo.Sensitivities(inputs, held, reported={"price": reported, "cost": reported})
    for shown in (
        numbers,
        estimate(),
        reported,
        reported.numbers()[0],
        table,
        snapo.Value(2.0, 0.1),
    ):
        assert repr(shown) == str(shown) and len(repr(shown)) < 2000
    assert "(5 numbers), held" in repr(table["price"]) and "95 %" in repr(table["price"])
    with pytest.raises(KeyError, match=r"no input 'prise'; did you mean 'price'\? The inputs are"):
        table["prise"]


CELLS = (
    """
    from tests.solver.twelve import Swing, policy, problem
    import snapo
    of = problem(Swing)
    training = snapo.Training(steps=4, paths=32, validation_paths=64, validation_every=2)
    few = snapo.Evaluation(paths=512, sensitivity_paths=512, smooth_paths=0)
    solution = snapo.solve(of, policy=policy(of), training=training, evaluation=few, engine="xla")
    """,
    "solution",
    "solution.plot.tornado()",
    "import matplotlib.pyplot as plt\nsolution.plot.distribution()",
    "solution.plot.training()",
    "_, axes = plt.subplots()\nsolution.plot.training(ax=axes)",
    """
    import os, signal
    sent = []
    def stop(progress):  # what the button of a notebook sends
        if progress.step == 4 and not sent:
            sent.append(True)
            os.kill(os.getpid(), signal.SIGINT)
    long = snapo.Training(steps=400, paths=32, validation_paths=64, validation_every=2)
    stopped = snapo.solve(
        of, policy=policy(of), training=long, evaluation=few, engine="xla", callbacks=[stop]
    )
    print(stopped.status, len(stopped.history), stopped.value == stopped.value)
    """,
)


@pytest.mark.prove
def test_a_notebook_has_one_picture_for_every_plot(monkeypatch):
    import textwrap

    nbclient, nbformat = (pytest.importorskip(name) for name in ("nbclient", "nbformat"))
    cells = [nbformat.v4.new_code_cell(textwrap.dedent(text)) for text in CELLS]
    notebook = nbformat.v4.new_notebook(cells=cells)
    monkeypatch.setenv("SNAPO_BAR", "0")
    nbclient.NotebookClient(notebook, timeout=300).execute()
    made, shown, *plots, drawn, stopped = [cell.outputs for cell in notebook.cells]
    assert not made
    assert shown[0].data["text/plain"].startswith("value ")
    for outputs in plots:
        (output,) = outputs
        assert "image/png" in output.data and "<Figure" not in output.data["text/plain"]
    assert len([output for output in drawn if "image/png" in output.get("data", {})]) == 1
    status, steps, is_number = stopped[0]["text"].split()
    assert status == "interrupted" and int(steps) < 10 and is_number == "True"
