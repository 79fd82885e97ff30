"""Every tutorial of the documentation, cell by cell in a fresh kernel: a picture for every plot."""

import os
import re
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
CELL = re.compile(r"^```\{code-cell\}\n(?::tags:[^\n]*\n)?(.*?)^```$", re.DOTALL | re.MULTILINE)
PAGES = [
    page for page in sorted(DOCS.rglob("*.md")) if CELL.search(page.read_text(encoding="utf-8"))
]
SMALL = r"""
import functools, snapo
training = snapo.Training(steps=4, paths=32, validation_paths=64, validation_every=2)
few = snapo.Evaluation(paths=512, sensitivity_paths=64, smooth_paths=0, judge_paths=0, search_paths=0)
snapo.solve = functools.partial(snapo.solve, training=training, evaluation=few)
snapo.bound = functools.partial(snapo.bound, paths=64)
"""
NUMBERS = {  # of the commands of the pages
    r"training\.steps=\d+": "training.steps=4",
    r"((training|evaluation)\.\w*paths)=\d+": r"\1=256",
    r"(snapo solve my(fund|store))": r"\1 --set evaluation.judge_paths=0 --set evaluation.search_paths=0",
    r"fund\.years=\d+": "fund.years=1",
}
SLOWEST = "fund"  # a minute of processor time, most of which compiles


def cells(page: Path) -> list[str]:
    """The cells of a page, with fewer paths."""
    texts = CELL.findall(page.read_text(encoding="utf-8"))
    for pattern, small in NUMBERS.items():
        texts = [re.sub(pattern, small, text) for text in texts]
    return texts


def test_no_tutorial_is_left_out():
    assert len(PAGES) >= 6 and all(page.read_text().startswith("---") for page in PAGES)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=getattr(pytest.mark, mark))
        for page in PAGES
        for mark in ["study" if page.stem == SLOWEST else "prove"]
    ],
)
def test_a_tutorial_runs_in_a_fresh_kernel(page, tmp_path, monkeypatch):
    nbclient, nbformat = (pytest.importorskip(name) for name in ("nbclient", "nbformat"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(DOCS.parent / "src"))
    monkeypatch.setenv("SNAPO_BAR", "0")
    made = [nbformat.v4.new_code_cell(text) for text in (SMALL, *cells(page))]
    notebook = nbformat.v4.new_notebook(cells=made)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()
    plots = 0
    for cell in notebook.cells:
        shown = [output.get("data", {}) for output in cell.outputs]
        pictures = sum("image/png" in data for data in shown)
        assert pictures == len(re.findall(r"\.plot\.\w+\(", cell.source)), cell.source
        assert "<Figure" not in str(cell.outputs), cell.source
        plots += pictures
    assert plots == page.read_text().count(".plot.")
