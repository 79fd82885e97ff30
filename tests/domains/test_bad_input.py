"""Bad input of every kind in every domain: exit code 2, one message, nothing written.

The mistakes are generated from the format's own description (see `described`) and from the columns
of the CSVs, and `solve` meets them as it meets a user's. At least 300 must hold; there are more.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.domains.described import Wrong, wrong_keys
from tests.miniatures import MINIATURES

from snapo.cli.main import _parser, main
from snapo.study import run_folder
from snapo.testing.miniature import Miniature
from snapo.testing.mistakes import spoilt_files

TEMPLATES = {kind: each._replace(texts=None, assignments=()) for kind, each in MINIATURES.items()}
CASES = {
    **{f"{kind} template": each for kind, each in TEMPLATES.items()},
    "gas-storage quick": MINIATURES["gas-storage"],
    "pharma reactor": MINIATURES["pharma"],
}
# The share of a case's mistakes that is tried, one of so many, and the least number of those that
# there must be, so that none is lost unnoticed. A study tries all of them.
SHARES = {
    "gas-storage template": (2, 300),
    "gas-storage quick": (2, 300),
    "pension template": (11, 100),
    "pharma template": (7, 200),
    "pharma reactor": (2, 300),
    "own template": (2, 200),
    "inventory template": (3, 100),
    "control template": (2, 100),
    "swing template": (3, 60),
    "battery template": (3, 60),
    "park-and-loan template": (3, 60),
    "stores template": (3, 60),
    "plant template": (3, 60),
}
LABELS = {"own": ("week",), "inventory": ("period",)}  # columns of names, where any text is right
RAW = ("Input should", "Value error", "Traceback", "Errno")  # words of libraries


class Accepted(Exception):
    """The case was read, and the folder of the run would be made."""


@pytest.fixture
def complaints(tmp_path, capsys, monkeypatch) -> Callable[[str, int], tuple[int, list[str]]]:
    """(mistakes, complaints) of a case whose every n-th mistake is given to `solve`."""

    def accepted(out: Path):
        raise Accepted

    parser = _parser()  # the same for all mistakes: to make it takes longer than to read a case
    monkeypatch.setattr(run_folder, "check_writable", accepted)
    monkeypatch.setattr("snapo.cli.main._parser", lambda: parser)

    def judged(case: str, every: int) -> tuple[int, list[str]]:
        miniature = CASES[case]._replace(assignments=())
        folder = miniature.write(tmp_path).path
        command = ["solve", str(folder), "--out", str(tmp_path / "out")]
        if miniature.simulator is not None:
            command += ["--simulator", ":".join(miniature.simulator)]
        found = []
        mistakes = list(wrong(miniature, tmp_path))[::every]
        before = listing(tmp_path)
        for each in mistakes:
            file = folder / each.file
            whole = file.read_bytes()
            file.unlink()
            if each.content is not None:
                file.write_bytes(each.content)
            found += [f"{each.name}: {what}" for what in judge(command, each, capsys)]
            file.write_bytes(whole)
            if listing(tmp_path) != before:
                found.append(f"{each.name}: something was written")
                before = listing(tmp_path)
        return len(mistakes), found

    return judged


def wrong(miniature: Miniature, folder: Path) -> Iterator[Wrong]:
    """The mistakes of keys, and those of the CSVs that have no sense under any reading."""
    asked = miniature.request(folder)
    yield from wrong_keys(asked)
    for each in spoilt_files(asked.path, LABELS.get(miniature.kind, ())):
        if each.names:
            file = asked.path / each.name.partition(":")[0].partition(",")[0]
            whole = file.read_bytes()
            each.spoil(asked.path, {})
            content = file.read_bytes() if file.exists() else None
            file.write_bytes(whole)
            yield Wrong(each.name, file.name, content, each.names)


def judge(command: list[str], mistake: Wrong, capsys) -> Iterator[str]:
    """The complaints about the answer to one mistake."""
    try:
        code = main(command)
    except Accepted:
        yield "accepted"
        return
    except Exception as error:
        yield f"{type(error).__name__}: {error}"
        return
    said = capsys.readouterr()
    lines = said.err.splitlines()
    if code != 2 or said.out:
        yield f"exit code {code}, and on stdout {said.out!r}"
    if len(lines) != 1 or not said.err.startswith("snapo: ") or len(said.err) > 600:
        yield f"not one message: {said.err[:1000]}"
    missing = [word for word in mistake.names if word not in said.err]
    if missing or not any(ending in said.err for ending in (".toml", ".csv", ".npy")):
        yield f"the message lacks {missing or 'the file'}: {said.err}"
    if raw := [word for word in RAW if word in said.err]:
        yield f"the message is not in the product's words ({raw}): {said.err}"


def listing(folder: Path) -> list[str]:
    return sorted(str(each) for each in folder.rglob("*") if "__pycache__" not in each.parts)


@pytest.mark.prove
@pytest.mark.parametrize("case", CASES)
def test_a_mistake_is_one_message(case, complaints):
    every, least = SHARES[case]
    count, found = complaints(case, every)
    assert not found, f"{len(found)} of {count}:\n" + "\n".join(found[:50])
    assert count >= least


@pytest.mark.study
@pytest.mark.parametrize("case", CASES)
def test_every_mistake_is_one_message(case, complaints):
    count, found = complaints(case, 1)
    assert not found, f"{len(found)} of {count}:\n" + "\n".join(found[:50])


@pytest.mark.parametrize("case", ["gas-storage quick", "own template", "pharma reactor"])
def test_a_sample_of_the_mistakes(case, complaints):
    count, found = complaints(case, 97)
    assert count and not found, "\n".join(found)


def test_every_domain_has_its_share():
    assert sum(least for _, least in SHARES.values()) > 300
    assert {each.kind for each in CASES.values()} == set(MINIATURES)
