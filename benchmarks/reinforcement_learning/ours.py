"""Training by snapo: the curve of one run, nothing compiled before."""

from dataclasses import replace

import jax

from snapo.engine import choose
from snapo.solver.train import begin, train
from snapo.solver.windows.window import UPDATES

from .clock import Clock, Point, Tell
from .tasks import TASKS
from .yardstick import Yardstick


def solve(problem: str, seed: int, steps: int | None, tell: Tell) -> None:
    """Tells the points of one run of `steps` updates (None: the settings').

    The clock starts before the problem is made: what snapo prepares, such as the guide of a gas
    store, and what it compiles counts. So do the paths on which it validates.
    """
    clock = Clock()
    task = TASKS[problem](seed)
    training = replace(task.training, steps=steps) if steps else task.training
    lesson = task.lesson or task.problem
    policy = task.policy.for_problem(lesson.interface, jax.random.key(seed))
    engine = choose("auto", lesson, policy).train
    horizon = lesson.simulator.horizon
    with clock.paused():
        yardstick = Yardstick(task.problem, task.paths)

    def measure(progress) -> None:
        processor, wall = clock.read()
        validated = 2 + (progress.step - 1) // training.validation_every
        done = training.validation_paths * validated * horizon
        # A step back through windows: a sweep, and that many windows.
        done += sum(
            training.paths * (horizon + UPDATES * record.window) for record in progress.history
        )
        with clock.paused():
            value = yardstick.value(progress.best)
        tell(Point(problem, "snapo", seed, done, processor, wall, value))

    train(lesson, begin(policy, training, lesson), training, engine, (measure,))
