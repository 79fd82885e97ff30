"""The native engine's code serves every horizon: a longer case compiles no kernel."""

import numpy as np
import pytest
from tests.compilations import compilations
from tests.miniatures import MINIATURES

from snapo.engine.native.call import COMPILED
from snapo.problem.form import form_of
from snapo.problem.smooth import EXACT
from snapo.study.domain import Options, load

LONGER = {
    "gas-storage": "contract.end=2025-01-26",
    "battery": "contract.end=2026-05-04T14:00:00",
    "pension": "fund.years=3",
    "inventory": "horizon.periods=8",
}


@pytest.mark.prove
@pytest.mark.parametrize("kind", LONGER)
def test_a_longer_case_has_the_kernel_of_the_shorter_one(kind, tmp_path):
    request = MINIATURES[kind].write(tmp_path)
    horizons, forms = [], []
    for change in ((), (LONGER[kind],)):
        loaded = load(request._replace(assignments=(*request.assignments, *change)))
        study = loaded.domain.study(loaded.case, Options())
        assert study.setup is not None
        setup = study.setup()
        problem = setup.problem
        bound = setup.engines.evaluate.bind(problem)
        draws = problem.sources.evaluation.draws(np.arange(64), problem.simulator)
        with compilations() as made:
            totals = bound.values(setup.policy, draws, EXACT).totals
        assert np.isfinite(list(totals.values())).all()
        horizons.append(problem.simulator.horizon)
        forms.append(form_of(bound.simulator.on_step()))
    assert horizons[0] != horizons[1] and forms[0] == forms[1]
    assert COMPILED not in made
