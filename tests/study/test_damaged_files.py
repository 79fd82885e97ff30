"""Files of a run that are corrupted, cut short or another's: refused in words, or made again.

Never a traceback, and never another number in silence: whatever a command answers after the damage
is what it answered before, or a message that names the file.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tests.miniatures import MINIATURES

from snapo.case.csv import FileReference, read_array
from snapo.case.error import CaseError
from snapo.case.table import TableContext
from snapo.cli.main import main
from snapo.problem.actions import Box
from snapo.problem.policy import MLP
from snapo.solver import checkpoint
from snapo.solver.train import Training, initial_progress
from snapo.study import run_folder
from snapo.study.training import load_checkpoint

FOREIGN = b'{"layout": 2, "total": 9, "sums": {"total": 9}}'


def damages(content: bytes, other: bytes) -> Iterator[tuple[str, bytes]]:
    """(name, the file with that damage)."""
    middle = len(content) // 2
    flipped = bytearray(content)
    flipped[middle] ^= 4
    yield "empty", b""
    yield "cut", content[:middle]
    yield "a bit", bytes(flipped)
    yield "zeros", bytes(len(content))
    yield "another file", other
    yield "another kind", FOREIGN
    yield "no text", b"\xff\xfe\x00" + content
    if digits := [i for i, each in enumerate(content) if chr(each) in "123456789"]:
        other_digit = bytearray(content)
        other_digit[digits[-1]] = ord("8") if content[digits[-1]] != ord("8") else ord("3")
        yield "a digit", bytes(other_digit)


@pytest.fixture
def run(fake, case, capsys) -> Path:
    """The folder of a whole run of the fake domain."""
    assert main(["solve", str(case)]) == 0
    capsys.readouterr()
    return case / "run"


def numbers(run: Path) -> dict[str, Any]:
    """What a run says: the tables of its parts, its value and its status."""
    result = json.loads((run / "result.json").read_text())
    tables = {each.name: each.read_text() for each in (run / "parts").iterdir()}
    return tables | {key: result[key] for key in ("value", "status", "failures")}


FILES = (
    "run.json",
    "result.json",
    "parts/first-sum.json",
    "parts/doubled.json",
    "parts/alone.json",
)


@pytest.mark.prove
def test_damaged_files_of_a_run(run, case, capsys):
    """Resumed, reported and compared after each damage: 5 files, 7 or 8 damages, 3 commands."""
    run = run.resolve()  # the folder to which `run` points is damaged, not the link
    good, page = numbers(run), (run / "report.html").read_bytes()
    whole = Path(shutil.copytree(run, run.with_name("whole")))
    files = 0
    for name in FILES:
        content = (run / name).read_bytes()
        other = (run / FILES[FILES.index(name) - 1]).read_bytes()
        for damage, spoilt in damages(content, other):
            files += 1
            said = f"{name}, {damage}"
            for command in ("report", "compare", "resume"):
                (run / name).write_bytes(spoilt)
                words = {
                    "report": ["report", str(run)],
                    "compare": ["compare", str(whole), str(run)],
                    "resume": ["solve", str(case), "--resume"],
                }[command]
                code, printed = main(words), capsys.readouterr()
                message = printed.err.replace("note: a remark\n", "")
                if code == 2:
                    assert name in message and len(message.splitlines()) == 1, said
                    assert command != "resume" or name == "run.json", said
                else:
                    assert code == 0, said
                    if command == "report" and name != "result.json":
                        assert "None" in (run / "report.html").read_text(), said
                    elif command == "resume":
                        assert numbers(run) == good, said
                        assert (run / "report.html").read_bytes() == page, said
                        assert name == "result.json" or f"{name} was changed" in message, said
                restore(run, whole)
    assert files >= 30


def restore(run: Path, whole: Path) -> None:
    shutil.rmtree(run)
    shutil.copytree(whole, run)


def test_damaged_arrays_beside_a_case(tmp_path):
    """Paths of one's own in .npy and Parquet: cut, changed in the header, or another file."""
    parquet = pytest.importorskip("pyarrow.parquet")
    table = pytest.importorskip("pyarrow").table
    paths = np.arange(12.0).reshape(4, 3)
    np.save(tmp_path / "p.npy", paths)
    parquet.write_table(table({f"day{i}": paths[:, i] for i in range(3)}), tmp_path / "p.parquet")
    files = 0
    whole = {name: (tmp_path / name).read_bytes() for name in ("p.npy", "p.parquet")}
    for name, other in (("p.npy", "p.parquet"), ("p.parquet", "p.npy")):
        mention = FileReference(TableContext(tmp_path / "case.toml", "model", []), "paths", name)
        assert np.array_equal(read_array(mention, 3, "prices"), paths)
        wrong = [each for kind, each in damages(whole[name], whole[other]) if "bit" not in kind]
        wrong = [each for each in wrong if len(each) != len(whole[name]) or not any(each)]
        wrong += [whole[name][:10] + bytes([each]) + whole[name][11:] for each in (0, 7, 255)]
        for content in wrong:
            files += 1
            (tmp_path / name).write_bytes(content)
            try:
                found = read_array(mention, 3, "prices")
            except CaseError as error:
                assert name in str(error) and len(str(error).splitlines()) == 1
            else:
                assert np.array_equal(found, paths)
    assert files >= 14


TRAINED = ("solution.npz", "groups.npz", "policy.npz", "sensitivities.csv")


@pytest.mark.prove
def test_damaged_files_of_a_training(solved, sketched, tmp_path, capsys):
    """Of a solved miniature: refused where a file is needed, made again by `--resume`."""
    whole = solved("own") / "run"
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    files = 0
    for name in TRAINED:
        content = (whole / name).read_bytes()
        other = (whole / TRAINED[TRAINED.index(name) - 1]).read_bytes()
        for damage, spoilt in damages(content, other):
            files += 1
            (run / name).write_bytes(spoilt)
            if name == "sensitivities.csv":
                assert main(["report", str(run)]) == 0, damage
                assert f"{name} was changed or damaged" in (run / "report.html").read_text()
            else:
                assert main(["compare", str(whole), str(run)]) == 2, damage
                assert name in capsys.readouterr().err
        (run / name).write_bytes(content)
    assert files >= 20
    asked = MINIATURES["own"].request(solved("own"))
    sets = [word for each in asked.assignments for word in ("--set", each)]
    resume = ["solve", str(asked.path), *sets, "--simulator", "simulator:Reservoir", "--resume"]
    resume += ["--out", str(run)]
    state = (run / "checkpoint.npz").read_bytes()
    (run / "policy.npz").write_bytes(state)
    (run / "checkpoint.npz").write_bytes(state[: len(state) // 2])
    assert main(resume) == 2
    said = capsys.readouterr().err
    assert "policy.npz was changed or damaged" in said and "checkpoint.npz" in said
    (run / "checkpoint.npz").write_bytes(state)
    assert main(resume) == 0
    results = [json.loads((each / "result.json").read_text()) for each in (run, whole)]
    for key in ("value", "standard_error", "smoothing_gap"):
        assert results[0][key] == results[1][key]


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    """Of the same shapes, but of a run with other numbers; one without a mark is taken."""
    policy = MLP(Box(-np.inf, np.inf, 2), 3, key=jax.random.key(0), hidden=(4,))
    fresh, file = initial_progress(policy, Training(steps=3)), tmp_path / "checkpoint.npz"
    checkpoint.save(fresh, file, run_folder.mark({"seed": 1}))
    checkpoint.load(file, fresh, run_folder.mark({"seed": 1}))
    checkpoint.load(file, fresh)
    with pytest.raises(CaseError, match="belongs to another run; solve without --resume"):
        load_checkpoint(file, fresh, run_folder.mark({"seed": 2}))
