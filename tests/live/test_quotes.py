"""The page moves the quotes from which a curve is made."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.book.test_quotes import january, prices, store

from snapo.live.valuation import Valuation
from snapo.live.worker import open_run
from snapo.solver.evaluate import evaluate
from snapo.study import commands
from snapo.study.domain import Options

FEW = (
    "training.steps=2", "training.paths=32", "training.validation_paths=64",
    "evaluation.paths=256", "evaluation.sensitivity_paths=128", "evaluation.judge_paths=0",
    "evaluation.selection_paths=0", "evaluation.search_paths=0",
)  # fmt: skip


@pytest.mark.prove
def test_a_moved_quote_is_a_case_with_another_quote(tmp_path):
    """The value at a moved quote is that of the case whose file has it, to the bits; the
    derivative by a quote is the transpose of the curve's weights times those by day."""
    request = commands.CaseRequest(store(tmp_path / "one"), FEW)
    commands.solve(request, lambda text: None, out=tmp_path / "run")
    valuation = open_run(tmp_path / "run")
    assert isinstance(valuation, Valuation)
    shown = {x["name"]: x for x in valuation.inputs()}
    assert "forward_curve" not in shown and len(shown["quotes"]["values"]) == 3
    moved = {"quotes": shown["quotes"]["values"] + np.array([2.0, 0.0, 0.0])}
    tables = dict(valuation.stages(moved))
    other = store(tmp_path / "other", quotes=prices(january))
    loaded = commands.load(commands.CaseRequest(other, FEW))
    study = loaded.domain.study(loaded.case, Options())
    assert study.setup is not None
    setup = study.setup()
    paths, engine = valuation.counts.value, setup.engines.evaluate
    value = evaluate(setup.problem, valuation.policy, paths=paths, engine=engine)
    assert tables["value"]["value"] == value.value
    row = next(x for x in tables["deltas"] if x["input"] == "quotes")
    matrix = valuation.positions.sources["quotes"].matrix
    by_day = valuation.solution.sensitivities.of("forward_curve").value  # pyright: ignore
    assert_allclose(shown["quotes"]["slope"], matrix.T @ by_day)
    assert len(row["rows"]) == 3 and "forward_curve" not in {x["input"] for x in tables["deltas"]}
    assert_allclose(tables["value"]["by_input"]["quotes"], 2.0 * shown["quotes"]["slope"][0])
