"""The origin of a solution: seconds by stage, versions, and why a training was aborted."""

import platform
import threading
import time
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import jax
import numpy as np

from snapo.checker.check import check
from snapo.engine import Engine, Xla
from snapo.problem.noise.counter import only
from snapo.problem.policies.memory import remembering
from snapo.problem.problem import Problem
from snapo.problem.smooth import Smooth

from .adjoint import finite, float64
from .learning.progress import Progress
from .learning.settings import TrainingPlan

LIBRARIES = ("snapo", "jax", "jaxlib", "equinox", "optax", "numpy", "scipy", "llvmlite", "diffrax")


def versions() -> dict[str, str]:
    """The causes of the numbers in addition to the inputs: this package, its libraries and the
    machine."""
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: _version(name) for name in LIBRARIES},
    }


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


COMPILERS = ("/jax/core/compile", "/snapo/compile")  # events of compiling


class Clock:
    """Records the time of a run by stage, with compilation separate.

    A context manager: it listens to JAX's compiler and to that of the native engine until it is
    left. Nested compilation, such as the tracing of a kernel, counts once; that of other threads is
    not counted.
    """

    def __init__(self):
        self.seconds = {"compile": 0.0, "train": 0.0, "evaluate": 0.0}
        self._started, self._thread = time.perf_counter(), threading.get_ident()
        self._compiled: list[tuple[float, float]] = []
        self._listener: Any = self._heard

    def __enter__(self) -> "Clock":
        jax.monitoring.register_event_duration_secs_listener(self._listener)
        return self

    def __exit__(self, *_: object) -> None:
        jax.monitoring.unregister_event_duration_listener(self._listener)

    def _heard(self, event: str, duration: float, **_: Any) -> None:
        """An event is reported when it ends."""
        if event.startswith(COMPILERS) and threading.get_ident() == self._thread:
            now = time.perf_counter()
            self._compiled.append((now - duration, now))

    def stage(self, name: str) -> None:
        """Adds the time since the last call to this name, without the time of compiling."""
        now, heard = time.perf_counter(), sorted(self._compiled)
        compiled, reached = 0.0, self._started
        for first, last in heard:
            compiled += max(0.0, last - max(first, reached))
            reached = max(reached, last)
        self.seconds[name] += max(0.0, now - self._started - compiled)
        self.seconds["compile"] += compiled
        self._started, self._compiled = now, []

    def total(self) -> dict[str, float]:
        """The seconds of every stage, and of all together."""
        return self.seconds | {"total": sum(self.seconds.values())}


FEW = 8  # bad paths that are followed step by step
ADVICE = "snapo.check(simulator, inputs) searches for the line of code."
LATER = (
    "If the check reports nothing, training led the policy into states in which the simulator is "
    "non-finite: a smaller learning_rate than {rate:.3g}, or narrower bounds of the decisions, "
    "prevents this."
)


class FirstNonFinite(NamedTuple):
    """The first number of a path that is non-finite: "state water", "output cash"."""

    step: int
    name: str


def why_broken(problem: Problem, progress: Progress, training: TrainingPlan, engine: Engine) -> str:
    """A sentence on why a training diverged; empty if it did not.

    The last step's paths are simulated again, a few of the non-finite ones with complete
    trajectories.
    """
    if progress.status != "diverged" or not progress.history:
        return ""
    problem, policy = remembering(problem, progress.policy), progress.policy
    record = progress.history[-1]
    # What is written down last is the step that broke; its paths are those of the number before.
    smooth = Smooth(np.float32(record.temperature))
    draws = problem.sources.training.batch(record.step - 1, training.paths, problem.simulator)
    totals = float64(engine.bind(problem).values(policy, draws, smooth).totals)
    stopped = f"Training stopped at step {record.step} of {training.steps}:"
    advice = ADVICE
    if record.step > 1:  # the simulator was sound for all policies before
        advice = f"{ADVICE} {LATER.format(rate=progress.rate(training))}"
    invalid = {
        name: np.flatnonzero(~np.isfinite(totals[name])) for name in problem.objective.outputs
    }
    invalid = {name: paths for name, paths in invalid.items() if paths.size}
    if not invalid:
        return " ".join([stopped, _by_derivative(problem, record.bad_paths, draws.size), advice])
    summary = ", ".join(
        f"{paths.size} of {draws.size} paths are non-finite in output {name!r}"
        for name, paths in invalid.items()
    )
    lost = np.flatnonzero(~finite(totals, invalid))[:FEW]
    position = _first(problem, policy, only(draws, lost), smooth)
    if position is None:
        return f"{stopped} {summary}, in its terminal part or in the sum over steps. {advice}"
    return (
        f"{stopped} {summary}, first at step {position.step} of the {problem.simulator.horizon} "
        f"of a path, in {position.name}. {advice}"
    )


def _by_derivative(problem: Problem, invalid: int, paths: int) -> str:
    """The message if all totals are finite but derivatives are not: the checker knows where."""
    many = f"the derivatives of {invalid} of {paths} paths are" if invalid else "the gradient is"
    errors = check(problem.simulator, problem.inputs).errors
    text = f" {errors[0].where}: {errors[0].subject}" if errors else ""
    return f"{many} non-finite, although all totals are finite.{text}"


def _first(problem: Problem, policy, draws, smooth) -> FirstNonFinite | None:
    """The first step at which these paths are non-finite."""
    record = ("state", "outputs")
    trajectory = Xla().bind(problem).values(policy, draws, smooth, record=record).record
    kinds, positions = problem.simulator.totals(), []
    for kind, word in (("state", "state"), ("outputs", "output")):
        for path, leaf in jax.tree_util.tree_flatten_with_path(trajectory[kind])[0]:
            name = jax.tree_util.keystr(path, simple=True, separator=".")
            wrong = _not_finite(np.asarray(leaf), kinds.get(name) == "max")
            if wrong.any():
                # The state before step t was made by step t - 1.
                step = int(np.argwhere(wrong)[0][0]) - (kind == "state")
                positions.append(FirstNonFinite(max(step, 0), f"{word} {name}".strip()))
    return min(
        positions, default=None, key=lambda position: (position.step, position.name[0] != "s")
    )


def _not_finite(leaf: np.ndarray, largest: bool) -> Any:
    """Where an array is non-finite; minus infinity is allowed where a maximum has no number yet."""
    if leaf.dtype.kind != "f":
        return np.zeros(leaf.shape, bool)
    return ~np.isfinite(leaf) & ~(largest & (leaf == -np.inf))
