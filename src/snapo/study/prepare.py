"""Prepares a run: its folder, everything that affects its numbers, and its study. The case is new,
or is read again from the copy in the folder of its run.
"""

import ctypes
import datetime
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.report.record import PageTexts, RunRecord, entries_of

from . import run_folder
from .domain import Domain, Loaded, Options, RunsCode
from .run_folder import CASE, differences
from .runs.origin import origin

# Options of `snapo solve`, the part of a study that each asks for, and the noun of its message.
OPTIONAL = (
    ("ladder", "methods", "methods to compare"),
    ("hedge", "hedge", "hedge to simulate"),
    ("gamma", "gamma", "gamma by product"),
)

# Options of glibc (M_MMAP_THRESHOLD, M_TRIM_THRESHOLD, M_ARENA_MAX): the bytes from which an
# array is mapped apart, the free bytes that are returned, and the number of pools. What a thread
# frees stays in its pool, where other threads cannot use it; large arrays leave holes in a pool.
MAPPED_FROM, TRIM_FROM, MAX_POOLS = -3, -1, -8

if TYPE_CHECKING:
    from snapo.engine import Workers

    from .initial_policy import SuppliedPolicy
    from .study import ProgressCallback, Study


def case_of_run(out: Path, record: Mapping[str, Any]) -> tuple[Path, dict[str, Any]]:
    """The file of a run's case, and its tables with the keys that `--set` changed.

    **Raises:** `CaseError` if the copy in the run folder is missing.
    """
    recorded = record["decides"]["case"]
    results = [load(file) for file in sorted((out / CASE).glob("*.toml"))]
    if not results:
        message = "the copy of the case is missing; solve the case again"
        raise CaseError(str(out / CASE), "", None, message)
    file, data = min(results, key=lambda item: len(list(differences(_plain(item[1]), recorded))))
    return file, _as_recorded(data, recorded)


def options_of_run(domain: Domain, case: Any, record: Mapping[str, Any], engine: str) -> Options:
    """The options to study the case of a run again. The checks that it passed are omitted, unless
    its code has changed since then."""
    typed = entries_of(RunRecord, record)
    decided = typed.settings.options.items()
    same = not isinstance(domain, RunsCode) or domain.decides(case).items() <= decided
    return Options(engine, about=typed.about or None if same else None)


def _as_recorded(data: Any, recorded: Any) -> Any:
    """The tables of a file with the recorded values; unchanged values keep their types."""
    if isinstance(data, dict) and isinstance(recorded, dict):
        return {key: _as_recorded(data.get(key), value) for key, value in recorded.items()}
    if isinstance(data, list) and isinstance(recorded, list) and len(data) == len(recorded):
        return [_as_recorded(old, new) for old, new in zip(data, recorded, strict=True)]
    if _plain(data) == recorded:
        return data
    if isinstance(data, datetime.date) and isinstance(recorded, str):
        return type(data).fromisoformat(recorded)  # a date, or a date with a time
    return recorded


def _plain(data: Any) -> Any:
    """A value in the form that run.json has."""
    return json.loads(json.dumps(data, default=str))


def use_every_core() -> None:
    """Sets XLA to one device per core, if JAX has not computed anything yet, and stores its
    programs on disk. On a machine with a GPU, everything except an engine's simulation still runs
    on the CPU, because many small programs take longer to compile for a GPU than to run.
    """
    import jax

    from snapo.lanes.machine.code_cache import keep_programs

    keep_programs()
    jax.config.update("jax_default_device", "cpu")
    with suppress(RuntimeError):  # it has computed already: then it keeps the devices it has
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)


def keep_memory() -> None:
    """Lets the process keep memory that it has used, if the C library is glibc.

    This is for processes that repeat calls of the same sizes: it saves a large part of the time
    that the system would need to provide new memory pages. Threads share two pools of memory, which
    reduces the memory that the process holds.
    """
    if (set_option := _of_glibc("mallopt")) is not None:
        set_option(MAPPED_FROM, 16 << 20)
        set_option(TRIM_FROM, 2**31 - 1)
        set_option(MAX_POOLS, 2)


def return_memory() -> None:
    """Returns free memory to the system, if the C library is glibc."""
    if (trim := _of_glibc("malloc_trim")) is not None:
        trim(0)


def _of_glibc(name: str) -> Callable[..., int] | None:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


class Wanted(NamedTuple):
    """The options of `snapo solve` other than the case.

    - `engine`, `reference`, `ladder`, `hedge`, `gamma`: as in `Options`.
    - `resume`: continue the run.
    - `policy`: a run folder, or the file of a policy, with which training begins.
    - `about`: the `about` of another run of the same case, whose checks are also valid for this
      run.
    - `workers`: processes that compute groups of paths, with bit-identical results.
    """

    engine: str = "auto"
    reference: bool = False
    resume: bool = False
    policy: Path | None = None
    about: Mapping[str, Any] | None = None
    workers: "Workers | None" = None
    ladder: bool = False
    hedge: bool = False
    gamma: bool = False


@dataclass(frozen=True, eq=False)
class Prepared:
    """A run that is ready to be carried out: its case, its folder, the settings that determine its
    numbers, and its study."""

    loaded: Loaded
    out: Path
    decides: Mapping[str, Any]
    study: "Study"


def decided(
    loaded: Loaded, out: Path, requested: Wanted
) -> "tuple[dict[str, Any], SuppliedPolicy | None]":
    """The settings that determine the numbers of a run in the folder `out`, and its initial
    policy."""
    options: dict[str, Any] = {"engine": requested.engine}
    if isinstance(loaded.domain, RunsCode):
        options |= loaded.domain.decides(loaded.case)
    values = None
    if requested.policy is not None:
        from .initial_policy import read

        values = read(requested.policy, loaded.domain.kind, out, requested.resume)
        options["policy"] = values.checksum
    return run_folder.decisive(loaded.file, loaded.data, options), values


def is_same(loaded: Loaded, out: Path, requested: Wanted) -> bool:
    """Whether the folder `out` has the run to resume; False if it has no run. **Raises:**
    `CaseError` if it has a different run.
    """
    decides, _ = decided(loaded, out, requested)
    return run_folder.check_same(out, decides) is not None


def made_ready(loaded: Loaded, out: Path, requested: Wanted) -> Prepared:
    """The study of a case, whose training begins with the policy of the options, if there is one.

    **Raises:** `CaseError` if the policy does not fit, or the run to resume is a different one; in
    these cases nothing is written.
    """
    use_every_core()
    decides, values = decided(loaded, out, requested)
    before = run_folder.check_same(out, decides) if requested.resume else None
    about = entries_of(RunRecord, before).about or None if before else requested.about
    request = Options(
        requested.engine,
        requested.reference,
        about,
        requested.ladder,
        requested.hedge,
        requested.gamma,
    )
    study = _with_notes(loaded.domain.study(loaded.case, request), loaded.case.notes)
    for option, part, noun in OPTIONAL:
        if getattr(requested, option) and part not in (item.name for item in study.parts):
            message = f'a case of kind "{loaded.domain.kind}" has no {noun}'
            raise CaseError(f"--{option}", "", None, message)
    if values is not None:
        from .initial_policy import begun_with

        study = begun_with(study, values, str(loaded.file))
    if requested.workers is not None:
        study = _over(study, requested.workers, str(loaded.file))
    return Prepared(loaded, out, decides, study)


def _over(study: "Study", workers: "Workers", file: str) -> "Study":
    """The study with workers that compute groups of paths. **Raises:** `CaseError` if workers
    cannot be used.
    """
    from .study import Setup, with_change

    if study.setup is None:
        message = f"{file} trains no policy, so workers cannot be used"
        raise CaseError("--on, --workers", "", None, message)

    def distributed(setup: Setup) -> Setup:
        try:
            return setup._replace(engines=setup.engines.over(workers))
        except ValueError as error:
            raise CaseError("--on, --workers", "", None, str(error)) from None

    setup = with_change(study.setup, distributed)
    setup()  # a misfit is refused before anything is written
    return replace(study, setup=setup)


def _with_notes(study: "Study", notes: Iterable[str]) -> "Study":
    """The study with the remarks on its case among its notes."""
    every = dict.fromkeys([*notes, *study.about.get("notes", ())])
    return replace(study, about={**study.about, "notes": list(every)})


def carried_out(
    prepared: Prepared,
    resume: bool,
    progress: "ProgressCallback",
    began: float,
    adjacent: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Computes the parts of the study; returns the content of result.json.

    `began`: the `time.perf_counter()` at which the command began; `adjacent`: the time of other
    work for the run, in seconds.
    """
    from .carry_out import carry_out

    loaded, out, decides = prepared.loaded, prepared.out, prepared.decides
    run_folder.copy_case(loaded.file, out, entries_of(PageTexts, loaded.data.get("report")).logo)
    source = origin(loaded.file, loaded.assignments, out, decides)
    spent = time.perf_counter() - began
    return carry_out(
        loaded.domain, prepared.study, out, decides, resume, progress, spent, adjacent, source
    )
