"""What `snapo solve` saved comes back: the same value and policy in Python, ONNX, NumPy and a table."""

import csv
import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest
from tests.miniatures import FURTHER, LITTLE, MINIATURES

import snapo
from snapo.cli.main import main
from snapo.problem.smooth import Exact
from snapo.solver.solution import POLICY
from snapo.testing.miniature import Miniature, once

QUICK = "inventory"
SHORT = ("training.steps=4", "evaluation.paths=256", *LITTLE)


OTHERS = {  # policies that the miniatures do not have
    "memory": Miniature(
        "control",
        "double-integrator",
        ("plant.horizon=6", 'policy.memory="GRU"', "policy.hidden=[8]", *SHORT),
    ),
    "closed-loop": FURTHER["closed-loop"],
    "line": Miniature("inventory", "line", ("training.steps=2", "evaluation.paths=256", *LITTLE)),
}


def one_process(case: Miniature, run, tmp_path, capsys) -> None:
    result = json.loads((run / "parts" / "training.json").read_text())["solution"]
    solution = snapo.Solution.load(run.parent)  # the folder above the run
    assert solution.value == snapo.Solution.load(run).value == result["value"]
    policy = solution.policy
    assert policy is not None and solution.halfway is not None
    named = ["--simulator", ":".join(case.simulator)] if case.simulator else []
    capsys.readouterr()
    assert main(["export", str(run), "--onnx", "--table", "--python", *named]) == 0
    files = capsys.readouterr().out.split()
    assert files == [str(run / f"policy.{end}") for end in ("onnx", "py", "csv")]
    head, *rows = csv.reader((run / "policy.csv").read_text().splitlines())
    table = dict(zip(head, np.array(rows, float).T))
    seen = np.stack([table[name] for name in head if name.startswith("observation")], 1)[:1000]
    tabled = np.stack([table[name] for name in head if name.startswith(("action", "next"))], 1)
    assert len(seen) == 1000 and np.isfinite(tabled).all()
    with jax.enable_x64(True):
        decide = jax.jit(jax.vmap(lambda row: policy(row, Exact())))
        python = np.asarray(decide(jnp.asarray(seen)))
    unit = np.maximum(1.0, np.abs(python))
    assert np.max(np.abs(tabled[:1000] - python) / unit) < 1e-9
    command = "import json, sys, policy; print(policy.decide(json.load(sys.stdin)).tolist());"
    check = "assert 'jax' not in sys.modules and 'snapo' not in sys.modules"
    plain = subprocess.run(
        [sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {str(run)!r}); {command} {check}"],
        input=json.dumps(seen.tolist()), capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert np.max(np.abs(np.array(json.loads(plain)) - python) / unit) < 1e-9
    model = snapo.to_onnx(policy, features=seen.shape[1], dtype="float64")
    for content, kind, tolerance in (
        (model.SerializeToString(), np.float64, 1e-9),
        ((run / "policy.onnx").read_bytes(), np.float32, 1e-3),
    ):
        session = onnxruntime.InferenceSession(content)
        (graph,) = session.run(None, {"observation": seen.astype(kind)})
        # In float32 a whole number or an option may fall on the other side of a tie.
        same = np.max(np.abs(graph - python) / unit, axis=1) < tolerance
        assert same.mean() > (0.999 if kind is np.float64 else 0.98), same.mean()


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[] if kind == QUICK else [pytest.mark.prove]) for kind in MINIATURES],
)
def test_what_solve_saved_comes_back(kind, solved, tmp_path, capsys):
    run = solved(kind) / "run"
    if not (run / POLICY).exists():  # a recipe: nothing is trained
        assert main(["export", str(run), "--onnx"]) == 2
        assert "this run has no trained policy" in capsys.readouterr().err
        return
    one_process(MINIATURES[kind], run, tmp_path, capsys)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=getattr(pytest.mark, "study" if name == "line" else "prove"))
        for name in OTHERS
    ],
)
def test_policies_with_a_memory_and_of_several_places_come_back(name, solved, tmp_path, capsys):
    case = OTHERS[name]
    folder = solved(name) if name in FURTHER else once(tmp_path / name, case.solve)
    one_process(case, folder / "run", tmp_path, capsys)


def test_export_says_what_it_needs(solved, capsys, tmp_path):
    assert main(["export", str(solved(QUICK) / "run")]) == 2
    assert "--onnx, --python and --table" in capsys.readouterr().err
    assert main(["export", str(tmp_path), "--onnx"]) == 2
    assert "not the folder of a run" in capsys.readouterr().err
