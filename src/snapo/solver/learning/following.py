"""Settings that follow the problem where they are not given: paths, steps, rates and shares.

A path of many steps holds many decisions, so fewer paths tell as much; and a step of training over
a short horizon costs little, so there is time for more of them. Work counts the products that a
network takes over a path: horizon times parameters. It is the same on every machine.

More steps bear a higher rate, which falls to zero in the end; wider layers a lower one, since all
their weights move at once. A `Stop`, also in a `Product`, keeps the usual rate: its features are
scaled, and a put ended at 4.459 with the higher one, at 4.472 without.

Where many numbers are decided, one of them may end where a limit cuts it off, which no gradient
leads out of: a battery that always discharges at midnight, when it is empty. Two remedies are
taken. A tenth of every decision is drawn at random at first, which meets what the rule does not.
And weights decay, since nothing holds against it there: to a quarter over all steps, however many
they are. Ten batteries earned, of the best, 93.6 to 97.0 % with neither, 94.1 to 96.2 % with the
decay alone, 95.7 to 97.7 % with both; of the first five with exploration alone one earned 94.4 %.
Twelve stocks of known optimum, over 3,840 steps, cost .13 % too much with neither and .17 % with
both; .45 and .48 % with a decay of .2, seven times as large.

A `Choice`, `Integers` or a `Stop` decides between few values, so that where the weights begin
matters more: several of them begin, and the better half goes on (`starts`).
"""

import math

import jax
import numpy as np

from snapo.problem.actions import Actions, Choice, Integers, Stop, contains
from snapo.problem.policy import Network, Policy, parameters
from snapo.problem.problem import Problem

from .settings import RATE, Training, TrainingPlan, every

WORK = 1.2e8  # products of one step of training: some hundredths of a second on two cores
PATHS = (16, 512)  # at least, at most
ALIKE = 64  # at most, where all paths are one
STEPS = (240, 3840)
USUAL = 480  # steps, at a horizon of 100, up to which `RATE` is right: a plant's must not leap
WIDTH = 32  # of hidden layers at which it is
MANY = 8  # numbers decided in one step, above which weights decay and decisions explore
LEFT = 1 / 4  # of a weight that nothing holds, after all steps
EXPLORED = 0.1  # share of a decision
SEVERAL = 4  # first weights, where decisions are of few values
LONG = 96_000  # steps of the simulator that all steps of training go through, on one path
RATED = 48_000  # the same, of the steps that the rate follows: chosen before there were more


def resolve_auto(
    training: Training, problem: Problem, policy: Policy, fresh: bool = False
) -> TrainingPlan:
    """The training with numbers in place of all that follows the problem.

    `fresh`: the policy's networks were drawn for it, so that others may be.
    """
    if isinstance(training, TrainingPlan):
        return training
    paths, steps, rate = training.paths, training.steps, training.learning_rate
    decay, exploring, free = training.decay, training.exploration, training.steps == "auto"
    if exploring == "auto":
        exploring = EXPLORED if free and _explores(problem.action, training) else 0.0
    horizon, certain = problem.simulator.horizon, exploring == 0 and not problem.is_random
    if paths == "auto":
        work = horizon * max(1, parameters(policy).size)
        paths = _within(PATHS, 2 ** round(math.log2(max(1.0, WORK / work))))
        paths = min(paths, ALIKE) if certain else paths
    # The gradient of fewer paths is noisier, which more steps average out.
    noisy = (PATHS[1] / paths) ** 0.4 if paths < PATHS[1] and not certain else 1.0
    if steps == "auto":
        steps = round(noisy * _within(STEPS, LONG // horizon))
    if rate == "auto":
        rate = RATE
        if free and not contains(problem.action, Stop):
            usual = _within(STEPS, RATED // horizon)
            many = usual / STEPS[0] if usual > USUAL else 1.0
            rate *= math.sqrt(noisy * many)
            rate *= min(1.0, WIDTH / _width(policy)) ** 0.25
    if decay == "auto":
        # The rate falls to zero by a cosine, so that it is half as large on average.
        decay = -2 * math.log(LEFT) / (rate * steps) if free and problem.action.size > MANY else 0.0
    few_values = any(contains(problem.action, kind) for kind in (Choice, Integers, Stop))
    starts = SEVERAL if fresh and free and few_values else 1
    return TrainingPlan.of(
        training, paths=paths, steps=steps, learning_rate=rate, decay=decay, exploration=exploring,
        validation_every=every(steps), starts=starts,
    )  # fmt: skip


def _explores(action: Actions, training: Training) -> bool:
    """Whether a share of these decisions can be drawn, and they are many; without bounds nobody
    knows how far, and the share falls with the temperature."""
    bounded = all(np.isfinite(bound).all() for bound in action.bounds())
    return action.exploration_size > MANY and bounded and training.cools


def _width(policy: Policy) -> int:
    """The number of units in the widest layer of all networks; 1 where there is none."""
    nodes = jax.tree.leaves(policy, is_leaf=lambda node: isinstance(node, Network))
    networks = [node for node in nodes if isinstance(node, Network)]
    return max((bias.size for network in networks for bias in network.biases[:-1]), default=1)


def _within(limits: tuple[int, int], number: int) -> int:
    return min(limits[1], max(limits[0], number))
