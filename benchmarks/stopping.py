"""`python -m benchmarks.stopping [SEEDS [NAME …]]`: stopping problems whose value is known.

Each problem is written with `Stop`, trained with several seeds and valued on a million fresh paths.
An upper bound, which needs no input from the user, is computed on 4,096 of these paths. Known
values: American put by finite differences (Longstaff and Schwartz, *Review of Financial Studies*
14, 2001, table 1), max-calls by a lattice and by an interval (Andersen and Broadie, *Management
Science* 50, 2004, table 2), swing puts by a fine lattice (tests/solver/test_bound.py).
"""

import sys
import time
from typing import NamedTuple

import jax.numpy as jnp
from examples import american_put, max_call

import snapo

from .machine import machine

# By default 512 paths, 4,096 of validation and a rate of .01. With a quarter of these steps a
# max-call of two ended 3.9 % low at .01 with one seed of ten, and a swing put 1.3 % low at .005:
# on 4,096 paths of validation an early policy was kept that is no better on others.
LONGER = {"steps": 2400, "paths": 1024, "learning_rate": 0.005, "validation_paths": 16384}
SHARE = {"spot": 40.0, "strike": 40.0, "rate": 0.06, "volatility": 0.2}


class SwingPut(american_put.Put):
    """Rights to sell a share at the strike, at most one on each of fifty dates in a year."""

    horizon = 49  # decisions: on the last date there is nothing to wait for
    initial_noise_size = 1  # the first date is one step from today
    action: snapo.Stop = snapo.Stop()

    def prepare(self, inputs):
        year = jnp.arange(1.0, 50.0) / 50
        drift = (inputs["rate"] - inputs["volatility"] ** 2 / 2) / 50
        moves = {"drift": drift, "deviation": inputs["volatility"] / 50**0.5}
        steps = {"left": 1 - year, "discount": jnp.exp(-inputs["rate"] * year)}
        return snapo.Schedule({**inputs, **moves}, steps)

    def initial(self, terms, noise):
        spot = terms["spot"] * jnp.exp(terms["drift"] + terms["deviation"] * noise[0])
        return {"spot": spot, "right": self.action.initial()}

    def terminal(self, terms, state, smooth):
        payoff = jnp.maximum(terms["strike"] - state["spot"], 0.0)
        return {"cash": self.action.alive(state["right"]) * jnp.exp(-terms["rate"]) * payoff}


class Case(NamedTuple):
    """A problem and its known value."""

    simulator: snapo.Simulator
    inputs: dict
    value: float


def cases() -> dict[str, Case]:
    """All problems by name."""
    share = {name: snapo.Input(x) for name, x in SHARE.items()}
    return {
        "put": Case(american_put.Put(), american_put.inputs, 4.478),
        "max-call of 2": Case(max_call.MaxCall(noise_size=2), max_call.inputs, 13.902),
        "max-call of 5": Case(max_call.MaxCall(noise_size=5), max_call.inputs, 26.14),
        "swing put, 1": Case(SwingPut(), share, 2.3140),
        "swing put, 3": Case(SwingPut(action=snapo.Stop(rights=3)), share, 6.8707),
    }


def trained(case: Case, seed: int, paths: int = 4096) -> tuple[snapo.Problem, snapo.Solution]:
    """The problem, and its solution with only a value (no sensitivities)."""
    problem = snapo.Problem(
        case.simulator, case.inputs, snapo.Mean("cash"), snapo.Sources.of(None, seed)
    )
    few = snapo.Evaluation(paths=paths, sensitivity_paths=0, smooth_paths=0, judge_paths=0)
    return problem, snapo.solve(
        problem, training=snapo.Training(seed=seed, **LONGER), evaluation=few
    )


def measured(case: Case, seed: int, paths: int = 4096) -> snapo.Bound:
    """The policy's value and the upper bound, on the same paths."""
    problem, solution = trained(case, seed)
    assert solution.policy is not None
    return snapo.bound(problem, solution.policy, paths=paths)


def main(seeds: int, names: list[str]) -> None:
    """Prints a line for each problem and seed."""
    print(machine())
    for name, case in cases().items():
        for seed in range(seeds) if not names or name in names else ():
            problem, solution = trained(case, seed, 1_000_000)
            started = time.perf_counter()
            found = snapo.bound(problem, solution.policy, paths=4096)
            spent = time.perf_counter() - started
            upper, gap = found.upper, found.gap
            print(
                f"{name:<14} {case.value:>8.4f} seed {seed}: {solution.value:.4f} ± "
                f"{solution.standard_error:.4f} ({solution.value / case.value - 1:+.2%}), at most "
                f"{upper.value:.4f} ± {upper.standard_error:.4f}, gap {gap.value / case.value:.2%};"
                f" trained in {solution.seconds['train']:.0f} s, bound in {spent:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3, sys.argv[2:])
