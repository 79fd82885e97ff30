"""A run made ready: its folder, all that decides its numbers, and its study."""

import os
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from snapo.case.error import CaseError, Unquoted

from .. import run_folder
from ..domain import Loaded, Options, RunsCode

if TYPE_CHECKING:
    from ..study import ProgressCallback, Study


def use_every_core() -> None:
    """XLA runs one device per core, where JAX has not computed yet.

    On a machine with a GPU everything but an engine's rollouts runs on the processor all the same:
    its many small programs take longer to compile for a GPU than to run.
    """
    import jax

    jax.config.update("jax_default_device", "cpu")
    with suppress(RuntimeError):  # it has computed already: then it keeps the devices it has
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)


class Wanted(NamedTuple):
    """What `snapo solve` asks for beside the case.

    - `engine`, `reference`: as in `Options`; `resume`: go on with the run that is there.
    - `policy`: a run folder, or the file of a policy, with which training begins.
    - `about`: that of another run of the same case, which passed its checks for this one too.
    """

    engine: str = "auto"
    reference: bool = False
    resume: bool = False
    policy: Path | None = None
    about: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A run that can be carried out: its case, its folder, what decides it, and its study."""

    loaded: Loaded
    out: Path
    decides: Mapping[str, Any]
    study: "Study"


def output_folder(loaded: Loaded, out: Path | None) -> Path:
    """The folder of the run, which can be written.

    **Raises:** `CaseError` where it cannot, or is that of the case.
    """
    out = out or loaded.file.parent / "run"
    try:
        same = out.resolve() == loaded.file.parent.resolve()
    except (OSError, RuntimeError):  # links in a circle
        message = "this cannot be the name of a folder: its links go in a circle"
        raise CaseError(str(out), "", None, message) from None
    if same:
        message = "this is the folder of the case; a run has a folder of its own"
        raise CaseError("--out", "", Unquoted(str(out)), message)
    run_folder.check_writable(out)
    return out


def made_ready(loaded: Loaded, out: Path, requested: Wanted) -> Prepared:
    """The study of a case, beginning with a given policy where one is named.

    **Raises:** `CaseError` where the policy does not fit, or the run to resume is another one;
    nothing is written before.
    """
    use_every_core()
    options: dict[str, Any] = {"engine": requested.engine}
    if isinstance(loaded.domain, RunsCode):
        options |= loaded.domain.decides(loaded.case)
    values = None
    if requested.policy is not None:
        from .given import read

        values = read(requested.policy, loaded.domain.kind, out, requested.resume)
        options["policy"] = values.checksum
    decides = run_folder.decisive(loaded.file, loaded.data, options)
    before = run_folder.check_same(out, decides) if requested.resume else None
    about = before.get("about") if before else requested.about
    request = Options(requested.engine, requested.reference, about)
    study = _with_notes(loaded.domain.study(loaded.case, request), loaded.case.notes)
    if values is not None:
        from .begun import begun_with

        study = begun_with(study, values, str(loaded.file))
    return Prepared(loaded, out, decides, study)


def _with_notes(study: "Study", notes: Iterable[str]) -> "Study":
    """The study with the remarks on its case among its notes, also where it has none."""
    every = dict.fromkeys([*notes, *study.about.get("notes", ())])
    return replace(study, about={**study.about, "notes": list(every)})


def carried_out(
    prepared: Prepared,
    resume: bool,
    progress: "ProgressCallback",
    began: float,
    adjacent: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Does the parts of the study; returns what result.json says.

    `began`: when the command did, by `time.perf_counter()`; `adjacent`: seconds of other work for
    it.
    """
    from ..carry_out import carry_out

    run_folder.copy_case(prepared.loaded.file, prepared.out)
    spent = time.perf_counter() - began
    domain = prepared.loaded.domain
    return carry_out(
        domain, prepared.study, prepared.out, prepared.decides, resume, progress, spent, adjacent
    )
