"""Training by snapo: the curve of one run, with empty caches of compiled code."""

from dataclasses import replace

import jax

from snapo import Training
from snapo.engine import choose
from snapo.problem.problem import Problem
from snapo.solver.learning.progress import Progress
from snapo.solver.learning.windows import UPDATES
from snapo.solver.train import initial_progress, train

from .clock import Clock, Point, Tell
from .tasks import TASKS
from .yardstick import Yardstick


def solve(problem: str, seed: int, steps: int | None, tell: Tell) -> None:
    """Reports the points of one run of `steps` updates (None: those of the settings). The first
    point is the rule before any training, for which nothing was simulated. The clock starts before
    the problem is made: it includes what snapo prepares, such as the value table of a gas store,
    what it compiles, and the paths on which it validates.
    """
    clock = Clock()
    task = TASKS[problem](seed)
    training = replace(task.training, steps=steps) if steps else task.training
    lessons = [(task.lesson or task.problem, training)]
    if task.before and not steps:
        lessons.insert(0, task.before)
    # A problem keeps its own scenarios; those of training are to be the seed's.
    lessons = [
        (replace(lesson, sources=lesson.sources.reseeded(seed)), settings)
        for lesson, settings in lessons
    ]
    policy = task.policy.for_problem(lessons[0][0].interface, jax.random.key(seed))
    with clock.paused():
        yardstick = Yardstick(task.problem, task.paths)
        value = yardstick.value(policy)
    tell(Point(problem, "snapo", seed, 0, *clock.read(), value))
    made = 0  # steps of the simulator in the lessons before
    for lesson, settings in lessons:

        def measure(progress, lesson=lesson, settings=settings, made=made) -> None:
            processor, wall = clock.read()
            with clock.paused():
                value = yardstick.value(progress.best)
            steps = made + simulated(lesson, settings, progress)
            tell(Point(problem, "snapo", seed, steps, processor, wall, value))

        engine = choose("auto", lesson, policy).train
        ended = train(
            lesson, initial_progress(policy, settings, lesson), settings, engine, (measure,)
        )
        policy, made = ended.best, made + simulated(lesson, settings, ended)


def simulated(lesson: Problem, training: Training, progress: Progress) -> int:
    """The number of simulated steps, of one path each, in a training."""
    horizon = lesson.simulator.horizon
    validated = 2 + (progress.step - 1) // training.validation_every
    # A step back through windows: a sweep, and that many windows.
    swept = (horizon + UPDATES * record.window for record in progress.history)
    return training.validation_paths * validated * horizon + training.paths * sum(swept)
