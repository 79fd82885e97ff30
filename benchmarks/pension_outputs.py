"""The cost of the derivatives of K outputs: one adjoint pass for all, or one for each.

    python -m benchmarks.pension_outputs [--paths 1024] [--rounds 15]

The case is the small pension example over two years, with the native engine in float64 and with
decisions recorded and held fixed, as for the sensitivities of several outputs. Both ways run in one
process in turns; times are medians, in units of the time of a value pass.

On two busy cores (1024 paths, value pass 71 ms): K = 1 to 5 cost 1.04, 1.76, 2.17, 2.43 and 3.13
value passes in one call: all cotangents are propagated backwards over the tape of one forward
sweep, so that a further output costs half a value pass. With a forward sweep for each output they
cost 1.16, 1.86, 2.85, 3.65 and 4.60.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.chapters.outputs import requested
from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.results.setup import FUNDING, make_setup
from snapo.problem.smooth import Exact


def bound(folder: Path, paths: int):
    """The engine, its scenarios, recorded actions, and the weights of each output."""
    template = Path(str(DOMAIN.templates["small"]))
    for file in template.iterdir():
        (folder / file.name).write_text(file.read_text().replace("years = 10 ", "years = 2 "))
    setup = make_setup(read_case(folder), "native")
    problem, policy = setup.problem, setup.policy
    engine = setup.engines.evaluate.bind(problem)
    draws = problem.sources.evaluation.draws(np.arange(paths), problem.simulator)
    rolled = engine.values(policy, draws, Exact(), record=("action",))
    totals = {name: np.asarray(total) for name, total in rolled.totals.items()}
    weights = [problem.objective.weights(totals)]
    weights += [goal.weights(totals) for _, _, _, goal in requested(FUNDING)]
    return engine, policy, draws, rolled.record["action"], weights


def together(weights: list[dict], count: int) -> dict[str, np.ndarray]:
    """{output: [count, N]} the weights of the first `count` outputs."""
    names = {name for each in weights[:count] for name in each}
    size = len(next(iter(weights[0].values())))
    return {n: np.stack([w.get(n, np.zeros(size)) for w in weights[:count]]) for n in names}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=15)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        engine, policy, draws, actions, weights = bound(Path(folder), given.paths)

    def pull(count: int):
        options = {"actions": actions, "wrt": ("schedule",)}
        return engine.adjoint(None, draws, Exact(), together(weights, count), **options)

    counts = range(1, len(weights) + 1)
    work = {"value": lambda: engine.values(policy, draws, Exact())}
    work |= {f"K = {k}": (lambda k=k: pull(k)) for k in counts}
    spent: dict[str, list[float]] = {name: [] for name in work}
    for done in range(given.rounds + 1):
        for name, run in work.items():
            start = time.perf_counter()
            np.asarray(next(iter(run().totals.values())))
            if done:  # the first compiles
                spent[name].append(time.perf_counter() - start)
    value = statistics.median(spent["value"])
    print(f"{given.paths} paths, value pass {1e3 * value:.1f} ms")
    for k in counts:
        median = statistics.median(spent[f"K = {k}"])
        print(f"K = {k}: {median / value:.2f} value passes; required: {1 + 0.6 * k:.1f}")


if __name__ == "__main__":
    main()
