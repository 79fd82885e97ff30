"""The shell's completion of `snapo`: what bash offers at each place."""

import shutil
import subprocess

import pytest

from snapo.cli import main
from snapo.cli.completion import script


def offered(*words: str) -> list[str]:
    """What bash completes these words with, the last of which is not finished."""
    text = script(main._parser(), "bash")
    line = " ".join(f"'{word}'" for word in words)
    asked = f"{text}\nCOMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _snapo; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")
def test_bash_completes_commands_options_choices_and_kinds(tmp_path):
    assert offered("snapo", "so") == ["solve"]
    assert {"new", "check", "solve", "report", "--version"} <= set(offered("snapo", ""))
    assert offered("snapo", "solve", "--ref") == ["--reference"]
    assert offered("snapo", "solve", "mine", "--engine", "") == ["auto", "xla", "native"]
    assert offered("snapo", "certify", "run", "--penalty", "v") == ["value"]
    assert "pension" in offered("snapo", "new", "pens")
    folder = str(tmp_path / "mystore")
    (tmp_path / "mystore").mkdir()
    assert offered("snapo", "check", folder[:-2]) == [folder]


def test_the_kinds_are_those_of_the_package():
    import tomllib
    from pathlib import Path

    from snapo.cli.completion import KINDS

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert set(KINDS) == set(project["entry-points"]["snapo.domains"])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_command_prints_a_script(shell, capsys):
    assert main.main(["completion", shell]) == 0
    assert "snapo" in capsys.readouterr().out
