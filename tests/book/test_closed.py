"""A book opens no port, runs no code of a file, and prints one JSON object."""

import json
import pickle
import socket

import pytest
from tests.book.books import HERE, write_book
from tests.book.conftest import ROWS

from snapo.book import executors
from snapo.book.file import read_book
from snapo.book.folder import BookFolder
from snapo.book.job import BookJob, Cost, JobResult, enclosed, opened
from snapo.book.run import run_book
from snapo.case.error import CaseError
from snapo.cli.main import main


def test_no_port_is_opened(valued, tmp_path, monkeypatch):
    """Whatever listens has to be bound first."""

    def refuse(*_):
        raise AssertionError("a port is opened")

    monkeypatch.setattr(socket.socket, "bind", refuse)
    monkeypatch.setattr(socket.socket, "listen", refuse)
    result = run_book(
        read_book(write_book(tmp_path, ROWS[:1])), lambda _: None, HERE, out=tmp_path / "run"
    )
    assert result["status"] == "ok"


class Bomb:
    """Unpickling it would raise."""

    def __reduce__(self):
        return exec, ("raise SystemExit('unpickled')",)


def test_a_result_of_pickles_is_none(valued, tmp_path):
    """A file that was put among the results is read as arrays or not at all."""
    import numpy as np

    np.savez(tmp_path / "bomb.npz", table=np.array([Bomb()], dtype=object))
    data = (tmp_path / "bomb.npz").read_bytes()
    with pytest.raises(ValueError):
        JobResult.unpack(data)
    with pytest.raises(ValueError):
        JobResult.unpack(pickle.dumps(Bomb()))
    folder = BookFolder(tmp_path)
    (tmp_path / "answers").mkdir()
    folder.write("ab", enclosed(data, Cost(0.0, 0.0, "")))
    assert folder.read("ab") is None


def test_jobs_and_results_are_plain_bytes(valued):
    """What goes out and comes back is JSON and arrays: equal content has equal bytes."""
    contract = valued.book.contracts[0]
    job = BookJob.of(contract, valued.book.tasks, 7, stresses=(valued.book.stresses[0].moves,))
    data = job.pack()
    assert isinstance(json.loads(data), dict)
    assert BookJob.unpack(data) == job and BookJob.unpack(data).pack() == data
    for file in valued.out.glob("answers/*/*"):
        result, cost = opened(file.read_bytes())
        assert JobResult.unpack(result).pack() == result and cost.cpu_seconds > 0
        with pytest.raises(ValueError):
            opened(file.read_bytes()[:-1])


@pytest.mark.parametrize(
    "where", ["dask:tcp://10.1.2.3:8786", "dask:10.1.2.3:8786", "ray:10.1.2.3:6379"]
)
def test_an_open_network_is_refused(where, monkeypatch):
    monkeypatch.delenv("RAY_AUTH_MODE", raising=False)
    pytest.importorskip("distributed" if where.startswith("dask") else "ray")
    with pytest.raises(CaseError, match="--trust-network"):
        executors.worker_pools(where)


@pytest.mark.parametrize("where", ["nothing", "no_such_module:f", "json:loads", "json:nothing"])
def test_a_wrong_place_has_one_message(where):
    with pytest.raises(CaseError, match=r"--on: got .*dask:ADDRESS, ray:ADDRESS, or MODULE:FUNCT"):
        executors.worker_pools(where)


def test_an_executor_of_others(valued, tmp_path, monkeypatch):
    """`--on MODULE:FACTORY`, from the working folder."""
    (tmp_path / "mine.py").write_text(
        "from tests.book.books import InProcess\ndef two():\n    return [InProcess(), InProcess()]\n"
    )
    monkeypatch.chdir(tmp_path)
    made = executors.worker_pools("mine:two")
    assert len(made) == 2
    file = write_book(tmp_path / "book", ROWS[:4])
    result = run_book(read_book(file), lambda _: None, made, out=tmp_path / "run")
    assert result["sums"] == valued.result["sums"]


def test_stdout_is_one_json_object(valued, capfd):
    """Of a book that was valued already: `--resume` computes nothing, and the query answers."""
    book = str(valued.book.file)
    for arguments in (
        ["book", book, "--out", str(valued.out), "--resume", "--json"],
        ["book", str(valued.out), "--sql", "select count(*) as n from shares", "--json"],
        ["check", book, "--json"],
        ["report", str(valued.out), "--json"],
    ):
        assert main(arguments) == 0
        assert json.loads(capfd.readouterr().out)["status"] == "ok"


def test_stresses_and_tables_are_read(tmp_path):
    """Stresses of a table, a row each; of a period; markets that replace those of the contracts."""
    file = write_book(tmp_path, ROWS[:2], stresses='[[stress]]\ntable = "moves.csv"\n')
    (tmp_path / "moves.csv").write_text(
        "name,scale market.forward_curve,shift market.forward_curve@2025-01-10/2025-01-12\n"
        "a,1.1,\nb,,2\n"
    )
    a, b = read_book(file).stresses
    assert (a.name, a.moves[0].key, a.moves[0].scale) == ("a", "market.forward_curve", 1.1)
    assert b.moves[0].shift == 2.0 and str(b.moves[0].when[1]) == "2025-01-12"


WRONG = {
    "no stress of this kind": ('[[stress]]\nname = "x"\n', "scale, shift and set"),
    "two of a name": (
        '[[stress]]\nname = "x"\nscale = { "a.b" = 2 }\n' * 2,
        "two stresses have this name",
    ),
    "a period": (
        '[[stress]]\nname = "x"\nscale = { "a.b" = 2 }\nwhen = "2025"\n',
        "two months or days",
    ),
    "its end": (
        '[[stress]]\nname = "x"\nscale = { "a.b" = 2 }\nwhen = "2025-02/2025-01"\n',
        "the first day is after the last",
    ),
    "no such key": ("[tasks]\npolicy = 3\n", "tasks.policy"),
    "no such table": ('[[stress]]\ntable = "none.csv"\n', "none.csv"),
    "base": (
        '[[stress]]\nname = "base"\nscale = { "a.b" = 2 }\n',
        "this name means the unstressed",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes_have_one_message(name, tmp_path):
    text, message = WRONG[name]
    more = text if text.startswith("[tasks]") else ""
    stresses = "" if more else text
    file = write_book(tmp_path, ROWS[:1], stresses=stresses, more=more or "[tasks]\n")
    with pytest.raises(CaseError) as error:
        read_book(file)
    assert message in str(error.value) and len(str(error.value).splitlines()) == 1
