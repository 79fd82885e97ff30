"""The report and the live page of a solution, from Python: of an own problem, and of a run."""

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import pytest
from tests.solver.twelve import Spill, problem

import snapo

TRAINING = snapo.Training(steps=2, paths=32, validation_paths=64)
FEW = snapo.Evaluation(
    paths=256, sensitivity_paths=64, smooth_paths=0, judge_paths=0, search_paths=0
)


@pytest.fixture(scope="module")
def solution() -> snapo.Solution:
    return snapo.solve(problem(Spill), training=TRAINING, evaluation=FEW, engine="xla")


@pytest.mark.prove
def test_a_solution_has_a_report(solution, tmp_path):
    assert solution.report(tmp_path / "x.html") == tmp_path / "x.html"
    page = (tmp_path / "x.html").read_text()
    assert "<h1>Spill</h1>" in page and "mean of value" in page
    assert f"{solution.value:,.2f}"[:4] in page
    for heading in ("Sensitivities", "Distribution", "Over time", "Training history"):
        assert heading in page
    assert page.count("<svg") >= 5 and "was not" not in page and "failed" not in page
    assert sorted(file.name for file in tmp_path.iterdir()) == ["x.html"]


def test_what_a_report_needs(solution, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"'x.pdf'; it must be a name that ends in .html"):
        solution.report(tmp_path / "x.pdf")
    solution.save(tmp_path / "saved")
    loaded = snapo.Solution.load(tmp_path / "saved")
    for verb in (lambda: loaded.report(tmp_path / "x.html"), loaded.open):
        with pytest.raises(ValueError, match="without its problem; pass it as problem=problem"):
            verb()
    with pytest.raises(ValueError, match="without its policy"):
        replace(loaded, policy=None).report("x.html", solution.problem)
    report = loaded.report(tmp_path / "x.html", solution.problem).read_text()
    assert "<h1>Spill</h1>" in report
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(ModuleNotFoundError, match=r"solution.report needs jinja2: pip .*\[cli\]'"):
        solution.report(tmp_path / "x.html")


@pytest.mark.prove
def test_inputs_of_any_shape_and_label_are_written_and_read(tmp_path):
    from snapo.domains.own.in_python import _carry_out, _domain

    def with_inputs(extra):
        base = problem(Spill)
        return replace(base, inputs={**base.inputs, "extra": extra})

    cube = snapo.Input(jnp.arange(8.0).reshape(2, 2, 2), "m", move=0.5, meaning="a cube")
    named = {"a b": snapo.Input([1.0, 2.0], labels=("x", "y")), "c.d": snapo.Input(3.0)}
    of = with_inputs({"cube": cube, **named})
    solved = snapo.solve(of, training=TRAINING, evaluation=FEW, engine="xla")
    domain = _domain(solved, None, "open")
    _carry_out(solved, domain, tmp_path, every=False)
    file = tmp_path / "case" / "case.toml"
    import tomllib

    case = domain.read(file, tomllib.loads(file.read_text()))
    assert set(case.inputs) == set(of.inputs_by_name) == set(case.positions)
    for name, entry in of.inputs_by_name.items():
        assert (case.inputs[name].value == entry.value).all() and case.inputs[name] == entry, name


@pytest.mark.prove
def test_a_run_has_the_report_of_its_run(solved, tmp_path):
    run = solved("inventory") / "run"
    loaded = snapo.Solution.load(run)
    written = loaded.report(tmp_path / "page.html").read_bytes()
    assert written == (run / "report.html").read_bytes()


def test_an_open_page_ends_with_close(tmp_path):
    pytest.importorskip("aiohttp", reason="the page needs the extra `live`")
    from urllib.request import urlopen

    from snapo.live.open import LivePage
    from snapo.live.server import Server

    fake = Path(__file__).parents[2] / "live" / "fake_worker.py"
    ended = []
    server = Server(
        tmp_path, {"title": "T"}, [sys.executable, "-S", str(fake), str(tmp_path / "d")]
    )
    page = LivePage(server, lambda: ended.append(True))
    assert page.address in repr(page) and f'href="{page.address}"' in page._repr_html_()
    with urlopen(page.address) as answer:
        assert answer.status == 200
    began = time.monotonic()
    while server.workers.process is None and time.monotonic() - began < 60:
        time.sleep(0.01)  # the page is there before its calculation
    process = server.workers.process
    page.close()
    page.close()  # which does nothing more
    assert process is not None and process.returncode is not None and ended
    with pytest.raises(OSError):
        urlopen(page.address)
    assert "closed" in repr(page) and "closed" in page._repr_html_()


LISTENS = """
import json, sys
first = sys.stdin.buffer.read(int(sys.argv[1]))
print(json.dumps({"stage": "ready", "first": list(first[-3:])}), flush=True)
print(json.dumps({"stage": "done", "page": "p", "n": json.loads(sys.stdin.readline())["n"]}))
"""


def test_a_problem_passes_through_the_pipe_of_its_worker():
    """A megabyte of bytes of all values, before the first order; and no file holds it."""
    pytest.importorskip("aiohttp", reason="the page needs the extra `live`")
    from snapo.live.process import WorkerProcess

    problem, messages = bytes(range(256)) * 4096 + b"\n\r\0", []

    async def work():
        done = asyncio.Event()

        async def hear(message):
            messages.append(message)
            if message["stage"] == "done":
                done.set()

        command = [sys.executable, "-S", "-c", LISTENS, str(len(problem))]
        worker = WorkerProcess(command, hear, problem)
        await worker.ask({"do": "move", "page": "p", "n": 7})  # waits until it is ready
        worker.start()
        async with asyncio.timeout(60):
            await done.wait()
        await worker.close()

    asyncio.run(work())
    assert messages[0] == {"stage": "ready", "first": [10, 13, 0]}
    assert messages[1] == {"stage": "done", "page": "p", "n": 7}


def test_a_page_names_the_extra_that_is_missing(solution, monkeypatch):
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "snapo.live.server", raising=False)
    with pytest.raises(ModuleNotFoundError, match=r"solution.open needs aiohttp: .*snapo\[live\]'"):
        solution.open(browser=False)
    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs (aiohttp|cloudpickle): .*snapo\[live\]'"):
        solution.open(browser=False)


SESSION = """
import time
from dataclasses import replace
import snapo
from tests.domains.own.test_in_python import FEW, TRAINING
from tests.solver.twelve import Spill, problem

class Mine(Spill):  # of this session only, as in a notebook
    pass

of = problem(Spill)
of = replace(of, simulator=Mine())
solution = snapo.solve(of, training=TRAINING, evaluation=FEW, engine="xla")
page = solution.open(browser=False)
print(solution.value, page.address, flush=True)
time.sleep(600)
"""


@pytest.mark.prove
def test_a_page_shows_the_value_and_ends_with_its_session():
    aiohttp = pytest.importorskip("aiohttp", reason="the page needs the extra `live`")
    session = subprocess.Popen([sys.executable, "-c", SESSION], stdout=subprocess.PIPE, text=True)

    async def moved(address: str) -> tuple[dict, dict]:
        origin = re.match(r"http://[^/]+", address)[0]
        async with (
            asyncio.timeout(200),
            aiohttp.ClientSession() as client,
            client.ws_connect(f"{address}socket", origin=origin) as socket,
        ):

            async def heard(*stages):
                while (message := json.loads((await socket.receive()).data))["stage"] not in stages:
                    pass
                return message

            ready = await heard("ready", "failed")
            order = {"do": "move", "page": "p", "n": 1, "values": {"water": [60.0]}}
            await socket.send_json(order)
            return ready, await heard("value", "refused")

    try:
        value, address = session.stdout.readline().split()
        ready, after = asyncio.run(moved(address))
        assert ready["base"]["value"]["value"] == float(value)  # to the bits
        assert after["table"]["change"] != 0.0
        tasks = Path(f"/proc/{session.pid}/task").glob("*/children")
        workers = [int(pid) for file in tasks for pid in file.read_text().split()]
        assert workers
        session.send_signal(signal.SIGKILL)
        session.wait()
        until = time.monotonic() + 60
        while any(_alive(pid) for pid in workers) and time.monotonic() < until:
            time.sleep(0.1)
        assert not any(_alive(pid) for pid in workers)
    finally:
        session.kill()
        session.communicate()


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return False
