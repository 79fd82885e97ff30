"""Both precisions: training is float32, values are float64, and one simulator serves both."""

import jax
import numpy as np

from snapo.engine import Xla
from snapo.problem.noise import Stored
from snapo.problem.simulator import Simulator

from .arrays.tables import TABLE
from .findings import Notes
from .rollout import Run


def both_precisions(notes: Notes, simulator: Simulator, run: Run) -> None:
    """Rolls two of the paths in float32, then in float64, as training and evaluation do."""
    draws = Stored(run.draws.initial_noise[:2], run.draws.step_noise[:, :2])  # pyright: ignore
    weights = {name: np.full(2, 0.5) for name in run.totals}
    given = (simulator, run.policy, run.schedule, draws, run.smooth, weights)
    for precision in ("float32", "float64"):
        engine = Xla(precision=precision)
        try:
            jax.block_until_ready(engine.adjoint(*given).totals)
        except Exception as error:
            where, what, _ = notes.explained(error, "step")
            notes.error(where, f"It fails in {precision} after the other precision. {what}", TABLE)
            return
