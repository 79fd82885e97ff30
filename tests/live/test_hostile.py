"""Hostile inputs, one by one: each is refused or escaped, and the page goes on."""

import asyncio
import csv
import io
import json
from contextlib import suppress

import pytest

aiohttp = pytest.importorskip("aiohttp", reason="the page needs the extra `live`")

from tests.live.test_server import connected, heard, served  # noqa: E402
from yarl import URL  # noqa: E402

from snapo.live.scenarios import FOLDER, SavedScenarios  # noqa: E402
from snapo.live.server import LONGEST  # noqa: E402

MARKUP = "<script>alert(1)</script>"
BIG = "x" * (LONGEST + 1)


def move(values, **more):
    return json.dumps({"do": "move", "n": 1, "values": values, **more})


MESSAGES = {
    "a number that is none": '{"do": "move", "n": 1, "values": {"a": [NaN]}}',
    "infinity": '{"do": "move", "n": 1, "values": {"a": [-Infinity]}}',
    "beyond a double": '{"do": "move", "n": 1, "values": {"a": [1e999]}}',
    "a formula for a number": move({"a": ["=1+1"]}),
    "a command for a number": move({"a": ["=cmd|' /C calc'!A0"]}),
    "markup for a number": move({"a": [MARKUP]}),
    "a switch for a number": move({"a": [True]}),
    "a list in a list": move({"a": [[1.0]]}),
    "a table for a list": move({"a": {"0": 1.0}}),
    "a prototype for a table": '{"do": "move", "n": 1, "values": {"__proto__": {"a": 1}}}',
    "too many numbers": move({"a": [0] * 100_001}),
    "a choice that is a list": move({}, chosen={"unmet": ["waits"]}),
    "a choice that is a number": move({}, chosen={"unmet": 7}),
    "a choice as long as a book": move({}, chosen={"unmet": "w" * 101}),
    "a hundred and one choices": move({}, chosen={str(i): True for i in range(101)}),
    "choices that are a text": move({}, chosen=MARKUP),
    "another order": '{"do": "write", "folder": "/etc", "values": {}}',
    "a way to run code": '{"do": "__import__", "values": {}}',
    "no order at all": "[" * 100_000,
    "a scenario that leads out": '{"do": "forget", "id": "../../.."}',
    "a scenario by an absolute path": '{"do": "forget", "id": "/etc"}',
    "training of what nobody valued": '{"do": "train", "n": 77}',
}
PATHS = {
    "no token": "/",
    "a token too short": "/{short}/",
    "a token with more": "/{token}x/",
    "a path outside the page": "/{token}/..%2f..%2fetc%2fpasswd",
    "a path outside the run": "/{token}/scenario/%2e%2e.zip",
    "a download that leads out": "/{token}/shown/..%2frun.csv",
    "a case of nobody": "/{token}/case/p1-1;id.zip",
    "a report that leads out": "/{token}/../report.html",
    "source code": "/{token}/server.py",
}
HEADERS = {
    "another host": {"Host": "evil.example"},
    "a host that ends alike": {"Host": "127.0.0.1.evil.example"},
    "another origin": {"Origin": "http://evil.example"},
    "an origin of a file": {"Origin": "null"},
}
METHODS = ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE")
NAMES = {
    "markup in a name": MARKUP,
    "a formula in a name": '=HYPERLINK("http://evil.example")',
    "a way out in a name": "../../../etc/passwd",
    "a name that reads backwards": "\u202egnp.exe",
}


def run(work):
    asyncio.run(work)


@pytest.mark.parametrize("text", MESSAGES.values(), ids=MESSAGES)
def test_a_message(tmp_path, text):
    async def work():
        async with served(tmp_path) as (server, session), connected(server, session) as socket:
            await socket.send_str(text)
            answer = await heard(socket, "refused")
            assert answer["message"] and "Traceback" not in answer["message"]
            await socket.send_str(move({"a": [1.5]}))
            await heard(socket, "done")
        assert not (tmp_path / FOLDER).exists()

    run(work())


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_an_address(tmp_path, path):
    (tmp_path / "report.html").write_text("secret")

    async def work():
        async with served(tmp_path) as (server, session):
            path_ = path.format(token=server.token, short=server.token[:-1])
            address = URL(f"http://127.0.0.1:{server.port}{path_}", encoded=True)
            async with session.get(address) as answer:
                assert answer.status in (403, 404) and "secret" not in await answer.text()

    run(work())


@pytest.mark.parametrize("headers", HEADERS.values(), ids=HEADERS)
def test_who_asks(tmp_path, headers):
    async def work():
        async with served(tmp_path) as (server, session):
            answer = await session.get(server.address, headers=headers)
            assert answer.status == 403

    run(work())


@pytest.mark.parametrize("method", METHODS)
def test_another_method(tmp_path, method):
    async def work():
        async with served(tmp_path) as (server, session):
            answer = await session.request(method, server.address, data="x")
            assert answer.status == 405

    run(work())


def test_a_message_that_is_too_long_ends_its_page_alone(tmp_path):
    async def work():
        async with served(tmp_path) as (server, session), connected(server, session) as other:
            async with connected(server, session) as socket:
                with suppress(ConnectionError):  # the server may not read to the end
                    await socket.send_str(BIG)
                while (await socket.receive()).type is aiohttp.WSMsgType.TEXT:
                    pass
                assert socket.closed
            await other.send_str(move({"a": [1.5]}))
            await heard(other, "done")

    run(work())


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
def test_a_name(tmp_path, name):
    """It is kept as a text; its folder is plain, and no spreadsheet takes it for a formula."""
    kept = SavedScenarios(tmp_path)
    found = kept.keep(name, {name: [1.0]}, {"value": {"value": 1.0}})
    assert kept.folder_of(found).parent == tmp_path / FOLDER and found.isascii()
    for text in (kept.table(), kept.one(found)):
        for row in csv.reader(io.StringIO(text)):
            assert not any(cell[:1] in ("=", "+", "@") for cell in row)
