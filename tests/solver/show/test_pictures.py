"""A plot is a picture wherever a kernel shows it, without any set-up by the reader."""

import pickle

import pytest

from snapo.solver.figures import Figures
from snapo.solver.learning.progress import Record


def test_a_figure_has_its_picture(monkeypatch):
    pytest.importorskip("matplotlib")
    fields = {name: 0.0 for name in Record.__annotations__} | {"step": 1}
    figure = Figures(None, {}, [Record(**fields)], None, None).training()
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert pickle.loads(pickle.dumps(figure))._repr_png_().startswith(b"\x89PNG")
