"""The server: who may speak to it, what it answers, and that nothing it is told harms it."""

import asyncio
import io
import json
import sys
import zipfile
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

aiohttp = pytest.importorskip("aiohttp", reason="the page needs the extra `live`")

from snapo.live.process import WorkerProcess  # noqa: E402
from snapo.live.server import Server  # noqa: E402

FAKE = Path(__file__).with_name("fake_worker.py")


@asynccontextmanager
async def served(run):
    server = Server(run, {"title": "T"}, [sys.executable, "-S", str(FAKE), str(run / "died")])
    await server.start()
    async with aiohttp.ClientSession() as session:
        try:
            yield server, session
        finally:
            await server.close()


@asynccontextmanager
async def connected(server, session):
    origin = f"http://127.0.0.1:{server.port}"
    address = f"{server.address}socket"
    async with session.ws_connect(address, origin=origin) as socket:
        yield socket


async def heard(socket, stage):
    """The next message of a stage."""
    async with asyncio.timeout(20):
        while True:
            message = json.loads((await socket.receive()).data)
            if message["stage"] == stage:
                return message


def run(work):
    asyncio.run(work)


def test_without_its_token_nothing_is_shown(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session):
            home = f"http://127.0.0.1:{server.port}"
            paths = (
                "/",
                "/wrong/",
                f"/{server.token[:-1]}/",
                f"/x{server.token}/",
                "/wrong/main.js",
            )
            for path in paths:
                async with session.get(home + path) as answer:
                    assert answer.status == 403, path
            async with session.get(server.address) as answer:
                assert answer.status == 200 and "snapo" in await answer.text()

    run(work())


def test_another_host_and_another_origin_are_refused(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session):
            for name in ("evil.example", f"evil.example:{server.port}", "127.0.0.1", "127.0.0.1:1"):
                async with session.get(server.address, headers={"Host": name}) as answer:
                    assert answer.status == 403, name
            bad = (
                "http://evil.example",
                "null",
                f"https://127.0.0.1:{server.port}",
                "http://127.0.0.1",
            )
            for origin in bad:
                with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                    await session.ws_connect(f"{server.address}socket", origin=origin)
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await session.ws_connect(f"{server.address}socket")

    run(work())


def test_it_listens_on_this_machine_alone_and_the_browser_is_told_so(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session):
            assert server._runner.addresses[0][0] == "127.0.0.1" and len(server.token) >= 43
            async with session.get(server.address) as answer:
                policy = answer.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy and "unsafe" not in policy
                assert answer.headers["Referrer-Policy"] == "no-referrer"
                assert answer.headers["Cache-Control"] == "no-store"

    run(work())


@pytest.mark.parametrize(
    "path",
    ["../server.py", "..%2fserver.py", "%2e%2e/worker.py", "//etc/passwd", "main.js/..", "page.py",
     "scenario/..%2f..%2fresult.zip", "scenario/%2e%2e.zip", "scenario/none.zip", ".css", "a.b.js",
     "index.html", "scenario/a%00.zip"],
)  # fmt: skip
def test_no_path_leads_out_of_the_page(tmp_path, path):
    from yarl import URL

    async def work():
        async with served(tmp_path) as (server, session):
            answer = await session.get(URL(server.address + path, encoded=True))
            assert answer.status in (403, 404), path

    run(work())


HOSTILE = (
    "", "null", "[]", "1", "{", '"x"', "{}", '{"do": 1}', '{"do": "exec"}', '{"do": "write"}',
    '{"do": "move"}', '{"do": "move", "values": 1}', '{"do": "move", "values": {"a": 1}}',
    '{"do": "move", "values": {"a": ["x"]}}', '{"do": "move", "values": {"a": [true]}}',
    '{"do": "move", "values": {"a": [NaN]}}', '{"do": "move", "values": {"a": [1e999]}}',
    '{"do": "move", "values": {"a": [[1]]}}', '{"do": "move", "values": {"a": [null]}}',
    '{"do": "move", "values": {"a": [' + "9" * 5000 + "]}}",
    '{"do": "move", "values": {"a": [' + "9" * 400 + "]}}",
    '{"do": "move", "values": {"a": [' + "1," * 100_001 + "1]}}",
    '{"do": "keep", "name": "x"}', '{"do": "keep", "n": {}, "name": "x"}',
    '{"do": "keep", "n": 1e400, "name": ["x"]}', '{"do": "forget", "id": "../.."}',
    '{"do": "forget"}', '{"do": "forget", "id": {"a": 1}}', "[" * 100_000, "\ud800",
)  # fmt: skip


def test_hostile_messages_are_answered_and_harm_nobody(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session), connected(server, session) as socket:
            for text in HOSTILE:
                try:
                    await socket.send_str(text)
                except UnicodeEncodeError:
                    continue
                answer = await heard(socket, "refused")
                assert answer["message"], text[:60]
            await socket.send_str('{"do": "move", "n": 3, "values": {"a": [1.5]}}')
            assert (await heard(socket, "done"))["n"] == 3
        assert not (tmp_path / "scenarios").exists()

    run(work())


def test_a_scenario_is_kept_and_reaches_both_pages(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session):
            async with connected(server, session) as one, connected(server, session) as two:
                await heard(one, "scenarios")
                await heard(two, "scenarios")
                await one.send_str('{"do": "move", "n": 1, "values": {"a": [2.0]}}')
                await heard(one, "done")
                await one.send_str('{"do": "keep", "n": 1, "name": "<b>Cold</b>"}')
                for socket in (one, two):
                    (found,) = (await heard(socket, "scenarios"))["scenarios"]
                    assert found["name"] == "<b>Cold</b>" and found["values"] == {"a": [2.0]}
                (found,) = (await heard(two, "scenarios"))["scenarios"]
                assert found["case"]
            async with session.get(f"{server.address}scenario/{found['id']}.zip") as answer:
                packed = zipfile.ZipFile(io.BytesIO(await answer.read()))
                assert packed.namelist() == [f"{found['id']}/case.toml"]
            async with session.get(f"{server.address}scenarios.csv") as answer:
                assert (await answer.text()).startswith("scenario,value")

    run(work())


def test_a_killed_worker_starts_again_and_answers_what_was_asked(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session), connected(server, session) as socket:
            await heard(socket, "ready")
            await socket.send_str('{"do": "move", "n": 1, "values": {}}')
            await heard(socket, "done")
            await socket.send_str('{"do": "keep", "n": 1, "name": "before"}')
            await heard(socket, "written")
            await socket.send_str('{"do": "move", "n": 2, "values": {"die": [1.0]}}')
            await heard(socket, "starting")
            await heard(socket, "ready")
            assert (await heard(socket, "done"))["n"] == 2
            assert [each["name"] for each in server.scenarios.all()] == ["before"]

    run(work())


@pytest.mark.parametrize("turns", range(12))
def test_a_server_that_ends_while_its_worker_begins_ends(turns):
    """At each turn of the event loop another part of the beginning is awaited."""

    async def hear(message):
        pass

    async def work():
        crew = WorkerProcess([sys.executable, "-S", str(FAKE), "died"], hear)
        crew.start()
        for _ in range(turns):
            await asyncio.sleep(0)
        async with asyncio.timeout(20):
            await crew.close()
        assert crew.process is None or crew.process.returncode is not None

    run(work())


def test_what_is_shown_is_taken_away(tmp_path):
    (tmp_path / "report.html").write_text("<p>The report</p>")

    async def work():
        async with served(tmp_path) as (server, session), connected(server, session) as socket:
            name = (await heard(socket, "about"))["page"]
            await heard(socket, "ready")
            text = '{"do": "move", "n": 4, "values": {"=a": [2.5]}, "chosen": {"unmet": "waits"}}'
            await socket.send_str(text)
            await heard(socket, "done")

            async def got(path):
                async with session.get(server.address + path) as answer:
                    assert answer.status == 200, path
                    assert answer.headers["Content-Disposition"].startswith("attachment")
                    return await answer.read()

            table = (await got(f"shown/{name}-4.csv")).decode().splitlines()
            assert table[1] == "value,,,1.0,0.1,," and "chosen,unmet,waits,,,," in table
            assert "moved,'=a,1,2.5,,," in table
            assert (await got("shown/run.csv")).decode().splitlines()[1] == "value,,,2.0,0.5,,"
            packed = zipfile.ZipFile(io.BytesIO(await got(f"case/{name}-4.zip")))
            assert packed.namelist() == ["case/case.toml"]
            assert await got("case/run.xlsx") == b'kind = "x"\n'
            assert await got("report.html") == b"<p>The report</p>"
            for path in (f"shown/{name}-9.csv", "shown/p99-4.csv", "case/p99-1.zip"):
                async with session.get(server.address + path) as answer:
                    assert answer.status == 404

    run(work())
