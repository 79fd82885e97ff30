"""`snapo solve CASE --policy RUN`: training begins with an earlier policy, or says why it cannot."""

import json
import shutil
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.miniatures import MINIATURES

from snapo.case.error import CaseError
from snapo.cli.main import main
from snapo.problem.actions import Box, Integers
from snapo.problem.carry.save import save
from snapo.problem.policies.memory import GRU
from snapo.problem.policies.rules import Constant
from snapo.problem.policy import MLP, Residual, parameters
from snapo.solver import checkpoint
from snapo.solver.solution import POLICY, Solution
from snapo.study import commands, training
from snapo.study.initial_policy import read
from snapo.study.prepare import Wanted, made_ready
from snapo.testing.miniature import quiet

SMALL = MINIATURES["inventory"]
KEY = jax.random.key(3)


def saved(policy, file: Path) -> Path:
    """A policy as a run keeps it."""
    save(policy, file, None, code=True)
    return file


def given(file: Path):
    return read(file, "own", file.parent / "run", False)


def moved(policy, by: float):
    """The policy with every trained number moved."""
    return jax.tree.map(lambda leaf: leaf + by if eqx.is_inexact_array(leaf) else leaf, policy)


def net(action=None, features=3, **more):
    return MLP(action or Box(-np.inf, np.inf, 2), features, key=KEY, **{"hidden": (4,), **more})


def test_a_file_of_a_policy_is_read(tmp_path):
    policy = moved(net(), 0.25)
    policy.save(tmp_path / "mine.npz")
    found = given(tmp_path / "mine.npz").adopted_by(net())
    assert np.array_equal(parameters(found), parameters(policy))


def test_limits_and_a_base_are_those_of_the_case(tmp_path):
    """They are not trained: an earlier run's would break the limits of this case."""
    old = moved(Residual(Constant(np.array([9.0])), Box(0.0, 9.0), 3, key=KEY, hidden=(4,)), 0.25)
    own = Residual(Constant(np.array([2.0])), Box(0.0, 3.0), 3, key=KEY, hidden=(4,))
    found = given(saved(old, tmp_path / "policy.npz")).adopted_by(own)
    assert np.array_equal(parameters(found), parameters(old))
    assert isinstance(found, Residual) and isinstance(found.base.array, Constant)
    assert found.action == Box(0.0, 3.0) and found.base.array.value == 2.0


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (lambda: net(activation=jax.nn.tanh), ["activation tanh", "needs silu"]),
        (lambda: net(features=5), ["4 x 5", "4 x 3", "takes 5 numbers, but the case has 3"]),
        (lambda: net(Box(-np.inf, np.inf, 3)), ["size 3", "needs 2"]),
        (lambda: net(Integers(0, np.inf, 2)), ["action Integers", "needs Box"]),
        (lambda: net(hidden=(8,)), ["hidden[0] 8", "needs 4"]),
        (lambda: net(hidden=(4, 4)), ["sizes", "4 x 4"]),
        (lambda: GRU(Box(-np.inf, np.inf, 2), 3, key=KEY, hidden=4), ["GRU", "MLP"]),
    ],
)
def test_a_policy_that_does_not_fit_is_refused_in_words(other, named, tmp_path):
    file = saved(other(), tmp_path / "policy.npz")
    with pytest.raises(CaseError) as refused:
        given(file).adopted_by(net())
    for each in (str(file), "does not fit", *named):
        assert each in str(refused.value), refused.value


def test_files_that_hold_no_policy_are_refused(tmp_path):
    text, arrays, state = (tmp_path / name for name in ("a.csv", "b.npz", "c.npz"))
    text.write_text("a,b\n")
    np.savez(arrays, leaf_0=np.array([object()], object))  # pickled inside: never opened
    checkpoint.save_arrays(state, {"policy": net(), "halfway": None}, {"mark": "x", "step": 1})
    for file, why in (
        (text, "not an .npz"),
        (arrays, "cannot be read"),
        (state, "state of a train"),
    ):
        with pytest.raises(CaseError, match=why) as refused:
            given(file)
        assert file.name in str(refused.value)
    with pytest.raises(CaseError, match=r"--policy: got .*there is no policy here"):
        given(tmp_path / "nowhere")


# Whole runs.


@pytest.mark.prove
def test_a_run_begins_with_an_earlier_one_and_goes_on(solved, tmp_path, capsys, request):
    """Into the folder of the earlier run, whose policy is removed there; then resumed."""
    run = Path(shutil.copytree(solved("inventory") / "run", tmp_path / "run"))
    before = json.loads((run / "result.json").read_text())
    asked = SMALL.request(solved("inventory"))
    result = commands.solve(asked, quiet, out=run, policy=run)
    start = result["start"]
    assert result["status"] == "trained" and start["policy"] == str(run)
    assert start["value"] == pytest.approx(result["value"] - before["value"], abs=1e-6)
    assert start["before"] == before["value"] and start["standard_error"] >= 0
    assert any("began with the policy of" in note for note in result["notes"])
    assert "began with the policy of" in (run / "report.html").read_text(encoding="utf-8")
    request.getfixturevalue("without_page")
    again = commands.solve(asked, quiet, out=run, policy=run, resume=True)
    assert again["value"] == result["value"]
    with pytest.raises(CaseError, match=r"policy = .*now it is not given"):
        commands.solve(asked, quiet, out=run, resume=True)
    capsys.readouterr()
    line = ["solve", str(asked.path), "--out", str(run)]
    more = [part for each in SMALL.assignments for part in ("--set", each)]
    assert main([*line, *more, "--policy", str(run), "--resume"]) == 0
    assert "given policy" in capsys.readouterr().out


@pytest.mark.prove
def test_an_interrupted_run_reports_its_best_policy_and_goes_on(
    solved, tmp_path, capsys, monkeypatch
):
    """Ctrl-C at the first validation, after the checkpoint."""
    keep, calls = training._keep, []

    def interrupted(*values):
        keep(*values)
        calls.append(values)
        if len(calls) == 1:
            raise KeyboardInterrupt

    asked, run = SMALL.request(solved("inventory")), tmp_path / "run"
    monkeypatch.setattr(training, "_keep", interrupted)
    line = ["solve", str(asked.path), "--out", str(run)]
    line += [part for each in SMALL.assignments for part in ("--set", each)]
    assert main(line) == 130
    out = capsys.readouterr().out
    assert "inventory: interrupted" in out and "--resume" in out and "report.html" in out
    result = json.loads((run / "result.json").read_text())
    solution = Solution.load(run)
    assert result["status"] == solution.status == "interrupted"
    assert result["value"] == solution.value and solution.policy is not None
    assert "interrupted after step" in (run / "report.html").read_text(encoding="utf-8")
    begun = read(run, "inventory", tmp_path / "other", False)
    assert begun.value == solution.value
    monkeypatch.undo()
    whole = json.loads((solved("inventory") / "run" / "result.json").read_text())
    assert commands.solve(asked, quiet, out=run, resume=True)["value"] == whole["value"]


def test_nothing_is_written_where_it_does_not_fit(solved, tmp_path, capsys):
    file = saved(net(), tmp_path / "policy.npz")
    line = ["solve", str(solved("inventory") / "case")]
    assert main([*line, "--out", str(tmp_path / "new"), "--policy", str(file)]) == 2
    assert "does not fit the case" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


# The code of the kind "own" is loaded again for every command.
@pytest.mark.prove
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[] if kind == "own" else [pytest.mark.prove])
        for kind in sorted(MINIATURES)
    ],
)
def test_every_kind_begins_with_its_own_run_and_with_no_other(kind, solved, tmp_path):
    run, out = solved(kind) / "run", tmp_path / "run"
    loaded = commands.load(MINIATURES[kind].request(solved(kind)))
    wanted = Wanted(policy=run)
    if not (run / POLICY).exists():  # a recipe: nothing is trained
        with pytest.raises(CaseError, match=r"trained policy|trains no policy"):
            made_ready(loaded, out, wanted)
        return
    setup = made_ready(loaded, out, wanted).study.setup
    assert setup is not None
    kept = Solution.load(run, like=setup().policy).policy
    assert kept is not None
    assert np.array_equal(parameters(setup().policy), parameters(kept)) and not setup().recipe
    other = solved("own" if kind != "own" else "inventory") / "run"
    with pytest.raises(CaseError, match="this run is of kind"):
        made_ready(loaded, out, Wanted(policy=other))
    assert not out.exists()
