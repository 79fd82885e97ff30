"""The verb: train a policy, measure it on the exact simulator, differentiate its value.

A run is three plain stages on one schedule: `train`, `evaluate`, `sensitivities`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Engines, choose
from snapo.problem.objective import Mean, Objective
from snapo.problem.policy import MLP, Policy
from snapo.problem.prepare import prepare
from snapo.problem.scenarios import Pseudo, Scenarios, Sobol, Supplied
from snapo.problem.simulator import Schedule, Simulator, probe
from snapo.problem.smooth import Exact, Smooth

from .evaluate import estimate, path_totals
from .sensitivity import sensitivities
from .solution import Solution
from .train import EVALUATE_STREAM, Callback, Progress, Training, begin, train
from .versions import versions


@dataclass(frozen=True)
class Evaluation:
    """How a policy is measured.

    - `paths`: fresh scenarios for the value; `sensitivity_paths` for held derivatives,
      `smooth_paths` for those through the policy (0: none).
    - `scenarios`: "pseudo-random" (antithetic) or "sobol".
    """

    paths: int = 65536
    sensitivity_paths: int = 16384
    smooth_paths: int = 4096
    scenarios: str = "pseudo-random"

    def source(self, seed: int) -> Scenarios:
        if self.scenarios == "sobol":
            return Sobol(seed)
        return Pseudo(seed, stream=EVALUATE_STREAM << 32)


class Clock:
    """Seconds by stage, the compiler's apart."""

    def __init__(self):
        self.seconds = {"compile": 0.0, "train": 0.0, "evaluate": 0.0}
        self._started, self._compiled = time.perf_counter(), 0.0
        self._listener: Any = self._heard
        jax.monitoring.register_event_duration_secs_listener(self._listener)

    def _heard(self, event: str, duration: float, **_: Any) -> None:
        if event.startswith("/jax/core/compile"):
            self._compiled += duration

    def stage(self, name: str) -> None:
        """Books the time since the last call under this name, less what was compiled in it."""
        now = time.perf_counter()
        spent, compiled = now - self._started, self._compiled
        self.seconds[name] += max(0.0, spent - compiled)
        self.seconds["compile"] += min(spent, compiled)
        self._started, self._compiled = now, 0.0

    def stop(self) -> dict[str, float]:
        jax.monitoring.unregister_event_duration_listener(self._listener)
        return self.seconds | {"total": sum(self.seconds.values())}


def solve(
    simulator: Simulator,
    inputs: PyTree,
    policy: Policy | None = None,
    *,
    objective: Objective | None = None,
    scenarios: Scenarios | None = None,
    training: Training | None = None,
    evaluation: Evaluation | None = None,
    engine: str | Engines = "auto",
    callbacks: Sequence[Callback] = (),
    progress: Progress | None = None,
    supplied: Supplied | None = None,
) -> Solution:
    """Trains a policy and returns what it is worth, with the derivative by every input.

    **Arguments:**

    - `policy`: what is trained; by default an `MLP` with two hidden layers of 32.
    - `objective`: made as large as possible; by default the mean of the only output there is.
    - `scenarios`: for the evaluation; by default fresh ones of `training.seed`.
    - `engine`: "auto", "xla" or "native".
    - `supplied`: scenarios of one's own to train on; then give others as `scenarios`.
    - `callbacks`: told the `Progress` at every validation; `progress`: one to go on from.
    """
    training, evaluation = training or Training(), evaluation or Evaluation()
    clock = Clock()
    schedule = prepare(simulator, inputs)
    objective = objective or _only_output(simulator, schedule)
    if policy is None:
        features = probe(simulator, schedule)[1].shape[0]
        policy = MLP(simulator.action, features, key=jax.random.key(training.seed))
    engines = choose(engine, simulator, policy, schedule) if isinstance(engine, str) else engine
    progress = progress or begin(policy, training)
    clock.stage("evaluate")
    given = (simulator, schedule, progress, objective, training, engines.train)
    progress = train(*given, callbacks, supplied)
    clock.stage("train")
    source = scenarios or evaluation.source(training.seed)
    found = measure(
        simulator, inputs, schedule, progress, objective, source, training, evaluation, engines
    )
    clock.stage("evaluate")
    return Solution(
        **found,
        policy=progress.best,
        halfway=progress.halfway,
        history=progress.history,
        seconds=clock.stop(),
        engine=engines.name,
        reason=engines.reason,
        paths={"train": training.paths, "evaluate": evaluation.paths},
        seed=training.seed,
        status=progress.status,
        versions=versions(),
    )


def measure(
    simulator: Simulator,
    inputs: PyTree,
    schedule: Schedule,
    progress: Progress,
    objective: Objective,
    source: Scenarios,
    training: Training,
    evaluation: Evaluation,
    engines: Engines,
) -> dict[str, Any]:
    """Value, smoothing gap and sensitivities of the best policy, as fields of a `Solution`."""
    policy, engine = progress.best, engines.evaluate
    smooth = Smooth(np.float64(training.temperature(training.steps)))
    given = (engine, simulator, policy, schedule, source, evaluation.paths)
    exact = path_totals(*given, Exact())
    value = estimate(objective, exact, source, simulator.control_variates())
    soft = path_totals(*given, smooth)
    gap = objective.value(exact) - objective.value(soft)
    table = sensitivities(
        simulator,
        inputs,
        policy,
        objective,
        source,
        min(evaluation.sensitivity_paths, evaluation.paths),
        smooth=smooth if evaluation.smooth_paths else None,
        smooth_paths=evaluation.smooth_paths,
        earlier=progress.halfway if progress.step > 1 else None,
        engine=engine,
    )
    norm = table.policy_gradient[0] if table.policy_gradient else float("nan")
    return {
        "value": value.value,
        "standard_error": value.standard_error,
        "control": value.control,
        "smooth_value": value.value - gap,
        "smoothing_gap": gap,
        "policy_gradient_norm": norm,
        "sensitivities": table,
        "totals": exact,
    }


def _only_output(simulator: Simulator, schedule: Schedule) -> Objective:
    """The mean of the only output, when there is but one."""
    from snapo.engine import Xla

    action = np.zeros((simulator.horizon, 2, simulator.action.size))
    draws = Pseudo().draws(np.arange(2), simulator)
    totals = Xla().values(simulator, None, schedule, draws, Exact(), actions=action).totals
    if len(totals) != 1:
        raise ValueError(
            f"solve: the simulator has the outputs {sorted(totals)}; say which one to make as "
            'large as possible, such as objective=Mean("profit") or -Mean("cost").'
        )
    return Mean(next(iter(totals)))
