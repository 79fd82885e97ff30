"""Every run of a case is kept, `run` leads to the latest, and old ones go by a command only."""

import json
import os
import threading
from pathlib import Path

import pytest

from snapo.case.error import CaseError
from snapo.cli.main import main
from snapo.problem.carry.latest import followed, target
from snapo.study import commands, run_folder
from snapo.study.commands import CaseRequest
from snapo.study.runs import store
from snapo.study.runs.store import locked
from snapo.testing.miniature import quiet

pytestmark = pytest.mark.usefixtures("fake", "without_page")


def names(case: Path) -> list[str]:
    return sorted(file.name for file in (case / "runs").iterdir())


def solve(case: Path, *words: str) -> Path:
    """The folder of a new run."""
    main(["solve", str(case), *words])
    return store.folders(case)[-1]


def test_a_second_solve_leaves_the_first_as_it_is(case):
    one = solve(case)
    before = {file.name: file.read_bytes() for file in one.iterdir() if file.is_file()}
    assert target(case / "run") == one and (case / "run").is_symlink()
    two = solve(case, "--set", "numbers=[1, 2, 6]")
    assert names(case) == sorted([one.name, two.name])
    assert target(case / "run") == two
    assert before == {file.name: file.read_bytes() for file in one.iterdir() if file.is_file()}
    assert json.loads((case / "run" / "result.json").read_text())["value"] == 9


def test_a_run_that_fails_leaves_run_where_it_is(case, capsys):
    one = solve(case)
    capsys.readouterr()
    two = solve(case, "--set", 'fails="first sum"')
    assert "`run` still points to an earlier run" in capsys.readouterr().err
    assert target(case / "run") == one and two != one
    assert main(["report", str(case)]) == 0


def test_without_a_good_run_the_last_one_counts(case):
    fails = ("--set", 'fails="first sum"')
    for count in (1, 2):
        last = solve(case, *fails)
        assert target(case / "run") == last and len(names(case)) == count


def test_twenty_at_once_are_twenty_runs(case):
    errors: list[BaseException] = []

    def work():
        try:
            commands.solve(CaseRequest(case), quiet)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    runs = store.folders(case)
    assert len(runs) == 20 == len(names(case))
    assert all(json.loads((run / "result.json").read_text())["value"] == 7 for run in runs)
    assert target(case / "run") in runs
    assert all(run_folder.read(run)["parts"]["alone"]["state"] == "done" for run in runs)
    assert sorted(file.name for file in case.iterdir()) == ["case.toml", "run", "runs"]


def test_a_text_file_where_links_are_not_possible(case, monkeypatch, capsys):
    def refuse(*_, **__):
        raise OSError("no right to make a link")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    one, two = solve(case), solve(case)
    assert (case / "run").read_text() == f"runs/{two.name}\n"
    assert followed(case / "run" / "policy.npz") == two / "policy.npz"
    capsys.readouterr()
    assert main(["report", str(case / "run")]) == 0
    assert main(["compare", str(one), str(case / "run")]) == 0
    assert main(["runs", str(case / "run")]) == 0
    assert f"{two.name} *" in capsys.readouterr().out


def test_a_plain_folder_of_an_earlier_version(case, tmp_path, capsys):
    """It is read as it is; a new run moves it to the others."""
    main(["solve", str(case), "--out", str(tmp_path / "old")])
    (tmp_path / "old").rename(case / "run")
    assert main(["report", str(case / "run")]) == main(["report", str(case)]) == 0
    capsys.readouterr()
    assert main(["runs", str(case)]) == 0
    assert "run *" in capsys.readouterr().out
    result = (case / "run" / "result.json").read_bytes()
    two = solve(case)
    one, last = store.folders(case)
    assert (one / "result.json").read_bytes() == result and last == two
    assert target(case / "run") == two


def test_a_folder_that_is_no_run_is_not_touched(case, capsys):
    (case / "run").mkdir()
    (case / "run" / "notes.txt").write_text("mine")
    assert main(["solve", str(case)]) == 2
    assert "this is not a run" in capsys.readouterr().err
    assert [file.name for file in (case / "run").iterdir()] == ["notes.txt"]
    assert not (case / "runs").exists()
    (case / "run" / "notes.txt").unlink()
    assert main(["solve", str(case)]) == 0


def test_a_refused_solve_leaves_nothing(case, tmp_path):
    assert main(["solve", str(case), "--reference"]) == 2
    assert main(["solve", str(case), "--reference", "--out", str(tmp_path / "a" / "b")]) == 2
    assert [file.name for file in case.iterdir()] == ["case.toml"]
    assert not (tmp_path / "a").exists()


def test_resume_takes_the_latest_run_with_the_same_settings(case):
    one = solve(case, "--set", 'fails="alone"')
    (one / "parts" / "doubled.json").unlink()
    two = solve(case, "--set", "numbers=[1, 2, 6]")
    assert main(["solve", str(case), "--set", 'fails="alone"', "--resume"]) == 1
    assert (one / "parts" / "doubled.json").exists()
    assert store.folders(case) == [one, two]
    assert main(["solve", str(case), "--set", "numbers=[8]", "--resume"]) == 2


def test_no_run_replaces_one_that_is_kept(case, tmp_path, capsys):
    one = solve(case)
    other = tmp_path / "other"
    other.mkdir()
    (other / "case.toml").write_text((case / "case.toml").read_text())
    for out in (one, case / "run"):
        assert main(["solve", str(other), "--out", str(out)]) == 2
        assert "which is not replaced" in capsys.readouterr().err
    assert main(["solve", str(case), "--out", str(case / "run")]) == 0  # which is the default
    assert len(names(case)) == 2


def test_two_processes_do_not_write_into_one_run(case, tmp_path, capsys):
    one = solve(case)
    with locked(one / store.LOCK):
        assert main(["solve", str(case), "--resume"]) == 2
        assert "another process is working on this run" in capsys.readouterr().err
        assert main(["runs", str(case), "--remove", one.name]) == 2
        assert "stop it first" in capsys.readouterr().err
        assert main(["runs", str(case)]) == 0
        assert "running" in capsys.readouterr().out
    assert main(["solve", str(case), "--resume"]) == 0


def test_the_list_says_what_differs(case, capsys):
    one, two = solve(case), solve(case, "--set", "numbers=[1, 2, 6]", "--engine", "xla")
    capsys.readouterr()
    assert main(["runs", str(case)]) == 0
    out = capsys.readouterr().out
    assert "numbers: [1, 2, 4], [1, 2, 6]" in out and 'engine: "auto", "xla"' in out
    assert out.index(one.name) < out.index(f"{two.name} *")
    assert main(["runs", str(case / "case.toml"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["runs"]
    assert [row["value"] for row in rows] == [7, 9]
    assert [row["latest"] for row in rows] == [False, True]
    assert [(row["low"], row["high"]) for row in rows] == [(7, 7), (9, 9)]
    assert rows[0]["changes"] == [] and rows[1]["changes"][0]["name"] == "numbers"
    assert main(["runs", str(case / "none")]) == 2


def test_removal(case, capsys):
    runs = [solve(case) for _ in range(5)]
    assert main(["runs", str(case), "--remove", runs[0].name, runs[1].name[-4:]]) == 0
    assert store.folders(case) == runs[2:]
    assert main(["runs", str(case), "--remove", "2026-01-01T0000-beef"]) == 2
    assert main(["runs", str(case), "--remove", runs[4].name]) == 0
    assert target(case / "run") == runs[3]
    failed = [solve(case, "--set", 'fails="alone"') for _ in range(2)]
    assert main(["runs", str(case), "--keep", "1"]) == 0
    assert store.folders(case) == [runs[3], failed[-1]]  # the latest good one stays as well
    assert target(case / "run") == runs[3]
    assert main(["runs", str(case), "--remove", runs[3].name, failed[-1].name]) == 0
    assert not os.path.lexists(case / "run") and store.folders(case) == []


def test_compare_takes_any_number(case, capsys):
    runs = [solve(case, "--set", f"numbers=[1, {number}]") for number in (2, 5, 9)]
    capsys.readouterr()
    assert main(["compare", *map(str, runs)]) == 0
    out = capsys.readouterr().out
    assert "numbers: [1, 2], [1, 5], [1, 9]" in out and str(runs[2]) in out
    assert main(["compare", *map(str, runs), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["values"] == [3, 6, 10]
    assert [pair["difference"] for pair in table["comparisons"]] == [3, 7]
    assert main(["compare", str(case)]) == 2
    assert "name two runs or more" in capsys.readouterr().err


def test_a_link_of_a_user_stays(case, tmp_path):
    (tmp_path / "disk").mkdir()
    (case / "run").symlink_to(tmp_path / "disk")
    with pytest.raises(CaseError, match="this is not a run"):
        commands.solve(CaseRequest(case), quiet)
    assert (case / "run").resolve() == tmp_path / "disk"
