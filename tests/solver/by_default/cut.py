"""The problems of this folder with a part of their steps: the word that each training ends with."""

import jax
import numpy as np
from examples import american_put, own_simulator
from tests.solver.learning.test_convergence import INPUTS, Regulator
from tests.solver.learning.test_pendulum import Pendulum

import snapo
from snapo.solver.learning.settings import resolve_auto

from . import problems

SHARES = (0.05, 0.1, 0.2, 0.5, 1.0)


def _problem(simulator, inputs, output):
    return snapo.Problem(simulator, inputs, snapo.Mean(output))


def _saver():
    inputs = {name: snapo.Input(value) for name, value in problems.SAVER.items()}
    return _problem(problems.Saver(), inputs, "utility")


PROBLEMS = {
    "reservoir": lambda: _problem(own_simulator.Reservoir(), own_simulator.inputs, "cash"),
    "regulator": lambda: _problem(Regulator(), INPUTS, "value"),
    "hydro": lambda: _problem(problems.Hydro(), problems.HYDRO, "value"),
    "saver": _saver,
    "cart": problems.cart,
    "put": lambda: _problem(american_put.Put(), american_put.inputs, "cash"),
    "pendulum": lambda: _problem(Pendulum(), {"gravity": snapo.Input(10.0)}, "value"),
    "stocks": lambda: _problem(problems.Stocks(), None, "value"),
    "battery": lambda: _problem(problems.Battery(), problems.BATTERY, "cash"),
}  # from the cheapest to the dearest


def cut(problem: snapo.Problem, share: float, paths: int = 8192) -> snapo.Solution:
    """The problem solved in a share of its steps."""
    policy = snapo.MLP().for_problem(problem.interface, jax.random.key(0))
    steps = resolve_auto(snapo.Training(), problem, policy).steps
    few = {"paths": paths, "sensitivity_paths": 1024, "smooth_paths": 1024, "judge_paths": 0}
    return snapo.solve(
        problem,
        training=snapo.Training(steps=max(1, round(share * steps))),
        evaluation=snapo.Evaluation(**few),
    )


def below(whole: snapo.Solution, part: snapo.Solution) -> tuple[float, float]:
    """How far the value of a part is below the whole one, on the same paths, and the error."""
    (name,) = whole.problem.objective.outputs
    apart = np.asarray(whole.totals[name]) - np.asarray(part.totals[name])
    pairs = apart.reshape(-1, 2).mean(1)  # antithetic
    return float(apart.mean()), float(pairs.std(ddof=1) / pairs.size**0.5)
