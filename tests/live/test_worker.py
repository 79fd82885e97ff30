"""The page's numbers are those of `snapo solve` of the moved case, to the bits."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from tests.miniatures import MINIATURES

from snapo.live.terms import Deltas, derivatives
from snapo.solver.measure.measure import MeasuredRun, measure
from snapo.solver.solution import Solution
from snapo.solver.train import initial_progress
from snapo.study import commands
from snapo.study.domain import Options
from snapo.study.run_folder import plain_json

MOVED = {
    "gas-storage": {"forward_curve": 1.03, "volatility": 1.1, "max_injection": 0.9},
    "own": {"price": 1.02},
    "pension": {"zero_rate": 1.01, "rate_volatility": 1.2},  # the second scales an observation
}


class Worker:
    """The real process, spoken to in lines."""

    def __init__(self, run, *options):
        command = [sys.executable, "-m", "snapo.live.worker", str(run), *options]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        self.ready = self.hear("ready")

    def end(self):
        self.process.stdin.close()
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def hear(self, *stages):
        while line := self.process.stdout.readline():
            message = json.loads(line)
            if message["stage"] in stages or message["stage"] == "failed":
                return message
        raise AssertionError("the worker ended")

    def ask(self, **order):
        self.process.stdin.write(json.dumps({"page": "p", **order}) + "\n")
        self.process.stdin.flush()

    def tables(self, n, values):
        """All tables of a move; the last one comes when the page has rested."""
        self.ask(do="move", n=n, values=values)
        found, stages = {}, ("value", "deltas", "today", "fans", "done", "health", "refused")
        while "health" not in found:
            message = self.hear(*stages)
            assert message["stage"] != "refused", message
            assert message["stage"] != "health" or "done" in found
            found[message["stage"]] = message.get("table")
        del found["done"]
        return found


KINDS = [
    pytest.param("gas-storage", marks=pytest.mark.prove),
    pytest.param("own", marks=pytest.mark.prove),
    pytest.param("pension", marks=pytest.mark.study),  # its code takes minutes to compile
]


@pytest.fixture(scope="module", params=KINDS)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def worker(kind, solved, tmp_path_factory):
    run = tmp_path_factory.mktemp("live") / "run"
    shutil.copytree(solved(kind) / "run", run)
    code = MINIATURES[kind].simulator
    options = ["--simulator", ":".join(code)] if code else []
    made = Worker(run, *options)
    yield made
    made.end()


def test_the_page_shows_what_solve_finds(kind, worker, solved, tmp_path):
    inputs = {each["name"]: each["values"] for each in worker.ready["inputs"]}
    moved = {
        name: (factor * np.array(inputs[name])).tolist() for name, factor in MOVED[kind].items()
    }
    found = worker.tables(1, moved)
    run = solved(kind) / "run"
    solution, _, at_run = measured(worker, kind, run, {}, tmp_path / "case")
    _, setup, solved_anew = measured(worker, kind, run, moved, tmp_path / "moved")
    assert found["value"]["value"] == solved_anew["value"]
    assert found["value"]["standard_error"] == solved_anew["standard_error"]
    held = [each["sensitivities"].held for each in (at_run, solved_anew)]
    table = derivatives(Deltas(solution.sensitivities, *held), setup.problem.inputs_by_name)
    assert found["deltas"] == json.loads(json.dumps(plain_json(table)))
    assert found["value"]["value"] != worker.ready["base"]["value"]["value"]


def measured(worker, kind, run, values, folder):
    """The run's solution, and the page's case with these values as `solve` measures it."""
    worker.ask(do="write", n=1, values=values, folder=str(folder))
    assert worker.hear("written", "refused")["stage"] == "written"
    loaded = commands.load(commands.CaseRequest(folder, (), MINIATURES[kind].simulator))
    setup = loaded.domain.study(loaded.case, Options()).setup()
    solution = Solution.load(run, like=setup.policy)
    state = replace(initial_progress(solution.policy, setup.training), best=solution.policy)
    # The figures of the page alone: no smooth derivatives and no moves that judge.
    asked = replace(setup.evaluation, smooth_paths=0, judge_paths=0, selection_paths=0)
    of = MeasuredRun(setup.problem, solution.policy, state, setup.training, asked, setup.engines)
    return solution, setup, measure(of)


def test_refusals_come_in_the_words_of_the_case_format(worker):
    name = worker.ready["inputs"][0]["name"]
    for n, values in enumerate(({"nothing": [1.0]}, {name: [float(k) for k in range(999)]})):
        worker.ask(do="move", n=n, values=values)
        message = worker.hear("refused", "done")
        assert message["stage"] == "refused" and message["n"] == n
        assert "/tmp" not in message["message"]


def test_back_at_the_run_everything_is_the_run(worker):
    found, base = worker.tables(7, {}), worker.ready["base"]
    assert found == base and found["value"]["change"] == 0


def test_training_again_starts_from_the_policy_and_can_be_cancelled(kind, worker, tmp_path):
    if kind != "gas-storage":
        pytest.skip("one kind is enough")
    curve = next(each for each in worker.ready["inputs"] if each["name"] == "forward_curve")
    moved = {"forward_curve": [1.05 * x for x in curve["values"]]}
    found = worker.tables(20, moved)["value"]
    worker.ask(do="train", n=20, values=moved)
    assert worker.hear("training", "refused")["table"]["step"] == 0
    after = worker.hear("trained", "refused", "cancelled")["table"]
    assert after["value"] - after["gain"] == pytest.approx(found["value"], rel=1e-9)
    worker.ask(do="move", n=21, values=moved, policy=after["policy"])
    adopted = worker.hear("value", "refused")["table"]
    assert adopted["value"] == after["value"]
    assert adopted["change"] == pytest.approx(found["change"] + after["gain"], rel=1e-9)
    folder = tmp_path / "case"
    worker.ask(do="write", n=21, values=moved, policy=after["policy"], folder=str(folder))
    assert worker.hear("written", "refused")["stage"] == "written"
    worker.ask(do="move", n=22, values=moved, policy=str(folder / "policy.npz"))
    assert worker.hear("value", "refused")["table"]["value"] == after["value"]
    for policy in (7, str(folder / "none.npz")):
        worker.ask(do="move", n=23, values=moved, policy=policy)
        assert "this policy" in worker.hear("value", "refused")["message"]
    worker.ask(do="train", n=20, values=moved)
    worker.ask(do="cancel", n=-1)
    assert worker.hear("trained", "cancelled")["stage"] == "cancelled"
    assert worker.tables(21, moved)["value"] == found  # the page's policy is the run's
