"""A report as a PDF: by a browser of the machine, or by a script in its place."""

import sys
from pathlib import Path

import pytest

from snapo.case.error import CaseError
from snapo.report.page import VARIABLE, browser, print_page
from snapo.study import commands

SCRIPT = f"""#!{sys.executable}
import sys
from pathlib import Path
target = next(x.partition("=")[2] for x in sys.argv if x.startswith("--print-to-pdf="))
assert sys.argv[-1].startswith("file://") and sys.argv[-1].endswith("report.html")
{{}}
"""
PRINTS = 'Path(target).write_bytes(b"%PDF-1.7 made")'
FAILS = 'sys.exit("no display")'


def fake(folder: Path, what: str) -> str:
    script = folder / "browser"
    script.write_text(SCRIPT.format(what), "utf-8")
    script.chmod(0o755)
    return str(script)


@pytest.mark.skipif(sys.platform == "win32", reason="the script in place of a browser is of POSIX")
def test_the_report_is_printed_beside_itself(tmp_path, monkeypatch):
    (tmp_path / "report.html").write_text("<p>A</p>", "utf-8")
    monkeypatch.setenv(VARIABLE, fake(tmp_path, PRINTS))
    assert commands.printed(tmp_path) == tmp_path / "report.pdf"
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
    monkeypatch.setenv(VARIABLE, fake(tmp_path, FAILS))
    with pytest.raises(CaseError, match="ended with 1: no display"):
        commands.printed(tmp_path)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(CaseError, match=f"--pdf: no browser was found.*{VARIABLE}"):
        commands.printed(tmp_path)


@pytest.mark.prove
def test_a_real_browser(tmp_path):
    found = browser()
    if found is None:
        pytest.skip("There is no browser on this machine.")
    page, file = tmp_path / "report.html", tmp_path / "report.pdf"
    page.write_text("<h1>Report</h1><details><summary>More</summary>Folded</details>", "utf-8")
    print_page(page, file, found)
    assert file.read_bytes().startswith(b"%PDF") and file.stat().st_size > 1000
