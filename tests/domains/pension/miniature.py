"""The small example with a short horizon and little training, from its file to its folder."""

import shutil
from pathlib import Path
from typing import Any

from snapo.case.load import load
from snapo.domains.pension import DOMAIN
from snapo.study import run_folder
from snapo.study.carry_out import carry_out
from snapo.study.domain import Options

TEMPLATES = Path(str(DOMAIN.templates["small"])).parent
SHORT = (
    ("years = 10 ", "years = 2 "),
    ("steps = 300\npaths = 512", "steps = 4\npaths = 32\nvalidation_paths = 64\nseed = 3"),
    ("points = 5\nsteps = 40 ", "points = 2\nsteps = 2 "),
    ("paths = 16384\nsensitivity_paths = 4096", "paths = 512\nsensitivity_paths = 256"),
)


def short_case(folder: Path, changes=()) -> Path:
    """A copy of the small example in `folder`, made short; `changes` are (file, old, new)."""
    shutil.copytree(TEMPLATES / "small", folder)
    for file, old, new in (*(("case.toml", *pair) for pair in SHORT), *changes):
        text = (folder / file).read_text()
        assert old in text, old
        (folder / file).write_text(text.replace(old, new, 1))
    return folder


def solved(folder: Path, engine: str = "auto", resume: bool = False) -> dict[str, Any]:
    """The result of a run into `folder`/run."""
    file, data = load(folder)
    case = DOMAIN.read(file, data)
    study = DOMAIN.study(case, Options(engine))
    out = folder / "run"
    out.mkdir(exist_ok=True)
    run_folder.copy_case(file, out)
    decides = run_folder.decisive(file, data, {"engine": engine})
    return carry_out(DOMAIN, study, out, decides, resume, lambda text: None)
