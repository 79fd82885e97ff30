"""Results as data frames of three libraries: the numbers of the tables, by column."""

import numpy as np
import pytest

import snapo
from snapo.solver.derivatives.table import Sensitivities, SensitivityRow
from snapo.solver.statistics import Estimate
from snapo.solver.tables import frame

FOUND = Sensitivities(
    {"price": snapo.Input([30.0, 31.0], "EUR", labels=("May", "June"))},
    {"price": Estimate(np.array([[1.0, 2.0], [3.0, 6.0]]))},
)


@pytest.mark.parametrize("backend", ["pandas", "polars", "pyarrow"])
def test_sensitivities_come_in_every_library(backend):
    found = FOUND.frame(backend)
    if backend == "pyarrow":
        found = found.to_pandas()
    assert list(found.columns) == list(SensitivityRow._fields)
    assert list(found["label"]) == ["May", "June"] and list(found["held"]) == [2.0, 4.0]
    assert np.isnan(found["smooth"][0])


def test_another_library_is_refused():
    with pytest.raises(ValueError, match="'excel'; it must be one of pandas, polars, pyarrow"):
        frame({"a": [1]}, "excel")
