"""Sensitivities: the effect of one unit more of every input, with an interval.

Two derivatives of one value come from adjoint passes. HELD: the exact simulator with the recorded
decisions replayed; if the decisions are optimal, depend on the whole state and cause no jump, it is
the derivative of the optimal value (envelope theorem). SMOOTH: the smooth simulator through the
policy's reaction, as used in training. The reported one is the held one, unless a bump of the exact
simulator refutes it (`derivatives.verdict`); its interval has room for the error of the policy
(`derivatives.margin`).
"""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import numpy as np

from snapo.engine import Engine, Xla
from snapo.engine.base import Uncontrolled
from snapo.engine.xla import weighted_sum
from snapo.problem import inputs as inputs_
from snapo.problem.code.version import of_preparation, of_rollout, read_context, reading_once
from snapo.problem.meant import takes_problem
from snapo.problem.noise import Draws
from snapo.problem.objective import Objective, Totals
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import BLOCKS
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import EXACT, Exact, Smooth

from .adjoint import float64
from .derivatives.bump import FEWEST
from .derivatives.by_block import DerivativePass
from .derivatives.table import Sensitivities
from .statistics import Estimate

TEMPERATURE = 0.005  # at which a policy reacts in second derivatives
MINIMUM, MAXIMUM = 256, 64  # paths of a block where there are more than 32; blocks at most
DRIFT = 4  # a share of the blocks, one in four, is enough for the drift


@takes_problem
@reading_once()
def sensitivities(
    problem: Problem,
    policy: Policy,
    *,
    paths: int = 16384,
    smooth: Smooth | Exact = EXACT,
    engine: Engine | None = None,
    smooth_paths: int = 4096,
    earlier: Policy | None = None,
    actions: np.ndarray | None = None,
    totals: Mapping[str, np.ndarray] | None = None,
) -> Sensitivities:
    """Derivatives with decisions held fixed, on `paths`; with `Smooth(temperature)` also smooth
    derivatives, on `smooth_paths`. All are paths of the problem's evaluation. Standard errors come
    from 32 to 64 independent blocks of paths. `earlier` is a policy from the middle of training:
    its held derivatives on the first of the same paths show how much they still changed. `actions`
    [T, paths, A] are the policy's decisions on these paths, and `totals` {output: [paths]} their
    totals, if they were recorded before.
    """
    return sensitivities_and_totals(
        problem, policy, paths, smooth, smooth_paths, earlier, engine, actions, totals
    )[0]


@reading_once()
def sensitivities_and_totals(
    problem: Problem,
    policy: Policy,
    paths: int,
    smooth: Smooth | Exact,
    smooth_paths: int,
    earlier: Policy | None,
    engine: Engine | None = None,
    actions: np.ndarray | None = None,
    totals: Mapping[str, np.ndarray] | None = None,
) -> tuple[Sensitivities, Totals | None]:
    """`sensitivities`, and the smooth simulator's totals {output: [smooth_paths]}; None if they
    were not asked for, or are not all finite."""
    bound = (engine or Xla(precision="float64")).bind(problem, controls=False)
    source = problem.sources.evaluation
    paths = source.available(paths)
    blocks = source.blocks(paths, int(np.clip(paths // MINIMUM, BLOCKS, MAXIMUM)))
    if isinstance(bound.simulator, Uncontrolled):
        totals = None  # a program without control variates may round in another way
    exact = DerivativePass(problem, bound, policy, Exact(), True, actions, totals=totals)
    held, moved = exact.derivatives(blocks), None
    if earlier is not None:
        # Paired, so that a few blocks suffice; the weights of another objective are those of all.
        few = blocks[: max(FEWEST, len(blocks) // DRIFT)] if problem.objective.linear else blocks
        before = DerivativePass(problem, bound, earlier, Exact(), held=True).derivatives(few).inputs
        moved = {
            name: Estimate(held.inputs[name].blocks[: len(few)] - item.blocks)
            for name, item in before.items()
        }
    result = Sensitivities(
        problem.inputs_by_name, held.inputs,
        moved=moved, dropped=held.dropped, of_inputs=held.of_others,
    )  # fmt: skip
    if isinstance(smooth, Exact):
        return _without(result, problem.lost), None
    blocks = source.blocks(source.available(min(smooth_paths, paths)))
    soft = through_policy(problem, policy, smooth, engine).derivatives(blocks)
    dropped, norm = held.dropped + soft.dropped, soft.policy.norm()
    result = result._replace(smooth=soft.inputs, policy_gradient=norm, dropped=dropped)
    table = soft.totals if not soft.dropped else None
    if table is not None:
        order = np.argsort(np.concatenate(blocks))
        table = {name: total[order] for name, total in table.items()}
    return _without(result, problem.lost), table


def through_policy(
    problem: Problem, policy: Policy, smooth: Smooth, engine: Engine | None
) -> DerivativePass:
    """The derivative pass of `sensitivities` through the smooth simulator."""
    bound = (engine or Xla(precision="float64")).bind(problem, controls=False)
    return DerivativePass(problem, bound, policy, smooth, held=False)


def _without(result: Sensitivities, lost: tuple[str, ...]) -> Sensitivities:
    """A table without adjoint derivatives of the inputs that lose theirs (`Problem.lost`)."""

    def without_lost(table: dict[str, Estimate]) -> dict[str, Estimate]:
        unknown = {name: Estimate(np.full_like(table[name].blocks, np.nan)) for name in lost}
        return table | unknown

    smooth = None if result.smooth is None else without_lost(result.smooth)
    return result._replace(held=without_lost(result.held), smooth=smooth)


@takes_problem(objective=False)
def held_of_several(
    problem: Problem,
    policy: Policy,
    objectives: Sequence[Objective],
    *,
    paths: int,
    engine: Engine | None = None,
) -> list[dict[str, Estimate]]:
    """Held derivatives {input: Estimate} of each objective, as from `sensitivities` for one.

    The objectives share the recorded decisions and every forward sweep: one adjoint pass for each
    block of paths has a column of cotangents for each objective.
    """
    bound, source = (engine or Xla(precision="float64")).bind(problem), problem.sources.evaluation
    path = DerivativePass(problem, bound, policy, Exact(), held=True)
    return [result.inputs for result in path.of(objectives, source.blocks(source.available(paths)))]


@takes_problem
def second_order(
    problem: Problem,
    policy: Policy,
    *,
    directions: Sequence[Mapping[str, np.ndarray]],
    paths: int = 4096,
    smooth: Smooth | Exact | None = None,
) -> list[dict[str, np.ndarray]]:
    """The change of derivatives along directions of the inputs (forward over reverse).

    The derivatives are those with decisions held fixed, but along a direction the decisions respond
    through the smooth policy. Otherwise a value that is linear in prices would have no second
    derivative. Directions and results are {input: array}; a missing direction is zero. `smooth`:
    `Smooth(0.005)` by default. Only the XLA engine computes it; weights are held fixed if the
    objective is not linear.
    """
    engine, simulator, inputs = Xla(precision="float64"), problem.simulator, problem.inputs
    smooth = smooth or Smooth(TEMPERATURE)
    draws = problem.sources.evaluation.draws(np.arange(paths), simulator)
    totals = float64(engine.bind(problem).values(policy, draws, smooth).totals)
    weights = problem.objective.weights(totals)
    names, values = list(problem.inputs_by_name), inputs_.values(inputs)
    bare, results = inputs_.unnamed(inputs), []
    for direction in directions:
        unknown = set(direction) - set(names)
        if unknown:
            raise KeyError(
                f"second_order: there is no input {sorted(unknown)}; the inputs are {names}."
            )
        along = [
            np.broadcast_to(np.asarray(direction.get(n, 0.0), float), v.shape)
            for n, v in zip(names, values)
        ]
        version = of_preparation(simulator, inputs), of_rollout(simulator, policy, problem.schedule)
        with engine.numbers(), read_context(version):
            moved = _second(engine, simulator, bare, policy, draws, smooth, weights, values, along)
            results.append({name: np.asarray(x) for name, x in zip(names, moved)})
    return results


@eqx.filter_jit
def _second(engine: Xla, simulator, inputs, policy, draws: Draws, smooth, weights, values, along):
    def made(values) -> Schedule:
        return simulator.prepare(inputs_.replace(inputs, values))

    def held_gradient(values):
        call = engine.call(simulator, policy, made(values), draws, smooth)
        actions = engine.traced(call, ("action",)).record["action"]
        actions = actions[..., : simulator.action.size]  # without a policy's memory

        def value(moved):
            replayed = engine.call(simulator, None, made(moved), draws, smooth, actions=actions)
            return weighted_sum(engine.traced(replayed).totals, weights)

        return jax.grad(value)(values)

    return jax.jvp(held_gradient, (values,), (along,))[1]
