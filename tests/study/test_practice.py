"""Keys of `[training]` that a case cannot have are refused by file and key."""

from types import SimpleNamespace

import pytest

import snapo
from snapo.case.error import CaseError
from snapo.case.settings import read_training
from snapo.study.training import _resumed


def test_a_spread_without_initial_noise_is_refused_by_its_key(tmp_path):
    simulator = SimpleNamespace(initial_noise_size=0, action=snapo.Box(-float("inf"), float("inf")))
    training = snapo.Training(spread=2.0)
    setup = SimpleNamespace(training=training, problem=SimpleNamespace(simulator=simulator))
    run = SimpleNamespace(folder=tmp_path, resume=False)
    with pytest.raises(CaseError, match=r"training\.spread.*initial_noise_size"):
        _resumed(run, setup)  # pyright: ignore[reportArgumentType]


def test_exploration_needs_a_temperature_that_falls():
    same = {"exploration": 0.2, "temperature_start": 0.01, "temperature_end": 0.01}
    with pytest.raises(CaseError, match=r"training\.temperature_end.*exploration"):
        read_training(same, "case.toml")
    for key, value in (("keep", 0.0), ("spread", -1.0), ("exploration", 1.0)):
        with pytest.raises(CaseError, match=f"training.{key}"):
            read_training({key: value}, "case.toml")
    read = read_training({"keep": 0.95, "spread": 2.0, "exploration": 0.3}, "case.toml")
    assert (read.keep, read.spread, read.exploration) == (0.95, 2.0, 0.3)
    assert read_training({}, "case.toml").keep == "auto"
