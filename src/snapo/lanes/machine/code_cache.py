"""The user's folder of compiled code: kernels of the native engine and programs of XLA.

$XDG_CACHE_HOME/snapo/kernels    machine code of kernels, and kernels as traced
$XDG_CACHE_HOME/snapo/xla        XLA's programs

`XDG_CACHE_HOME` is `~/.cache` if it is not set. The oldest files beyond 512 MB in a folder are
removed. So are kernels that were not used for 60 days, when a kernel is made, and programs made
more than 60 days ago, when a command begins. Code from here is executed, so it must belong to the
user.
"""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from .disk import cache_home, cached, evict, is_private
from .linked import Linked

KERNELS, PROGRAMS = "kernels", "xla"


class CodeFolder(NamedTuple):
    """A folder of compiled code, with the number of its files and their size in bytes."""

    path: Path
    files: int
    size: int

    def __str__(self) -> str:
        return f"{self.path}   {self.files:,} files, {self.size / 1e6:,.1f} MB"


def code_folder(name: str) -> Path:
    """The folder of `KERNELS` or of `PROGRAMS`, which need not exist."""
    return cache_home() / "snapo" / name


def linked_code(text: str, entries: Mapping[str, int]) -> Linked:
    """The functions of a module's text, from the disk if their code was compiled before."""
    return Linked(cached(text, code_folder(KERNELS)), entries)


def keep_programs() -> None:
    """Keeps XLA's programs of this process on disk and reads them from there, unless the user has
    chosen another folder (`JAX_COMPILATION_CACHE_DIR`), or has switched the cache off."""
    import jax  # late: `snapo cache` shows the folders without it

    config = jax.config
    names = "jax_compilation_cache_dir", "jax_enable_compilation_cache"
    if tuple(getattr(config, name) for name in names) != (None, True):
        return
    folder = code_folder(PROGRAMS)
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not is_private(folder.stat()):
            return
        evict(folder)
        # Small programs too: to read one takes a tenth of the time of compiling it.
        config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        config.update("jax_compilation_cache_dir", str(folder))


def contents() -> list[CodeFolder]:
    """Both folders at present."""
    result = []
    for name in (KERNELS, PROGRAMS):
        sizes = [file.stat().st_size for file in _files(code_folder(name))]
        result.append(CodeFolder(code_folder(name), len(sizes), sum(sizes)))
    return result


def empty() -> None:
    """Removes all code. A running process keeps its code in memory."""
    for name in (KERNELS, PROGRAMS):
        for file in _files(code_folder(name)):
            with suppress(OSError):
                file.unlink()


def _files(folder: Path) -> list[Path]:
    with suppress(OSError):
        return [file for file in folder.iterdir() if file.is_file() and not file.is_symlink()]
    return []
