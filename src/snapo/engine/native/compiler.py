"""LLVM: what processor this is, and machine code from text, kept on disk between runs."""

import ctypes
import hashlib
import itertools
import os
import tempfile
import threading
from functools import cache
from pathlib import Path

import llvmlite
import llvmlite.binding as llvm
import numpy as np

CODE_MODEL = "large"
REGISTERS = 2  # per number and block: two chains side by side hide part of the latency
ENTRY_POINTS = {"prepare": 0, "run": 2, "finish": 0}


@cache
def host() -> tuple[str, str, int]:
    """The processor's name, its features, and the bytes of a vector register."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    llvm.load_library_permanently("")
    features = llvm.get_host_cpu_features()
    wide = features.get("avx512f") and features.get("avx512dq") and features.get("avx512vl")
    register = 64 if wide else 32 if features.get("avx2") else 16
    return llvm.get_host_cpu_name(), features.flatten(), register


def triple() -> str:
    """The machine that code is made for, such as x86_64-unknown-linux-gnu."""
    return llvm.get_default_triple()


def lanes(dtype: str) -> int:
    """Paths in one block: two vector registers of them."""
    _, _, register = host()
    return max(1, register // np.dtype(dtype).itemsize) * REGISTERS


class Machine:
    """The functions of one compiled kernel. It keeps the memory of the code alive."""

    def __init__(self, data: bytes, names):
        builder = llvm.JITLibraryBuilder().add_object_img(data).add_current_process()
        for name in names:
            builder.export_symbol(name)
        with _linking:
            self._tracker = builder.link(_linker(), f"kernel{next(_numbers)}")
        self.addresses = {name: self._tracker[name] for name in names}
        self.functions = {
            name: ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_int64] * ENTRY_POINTS[name])(
                address
            )
            for name, address in self.addresses.items()
            if name in ENTRY_POINTS
        }


_linking = threading.Lock()
_numbers = itertools.count()


@cache
def _linker():
    """One linker for the process; libraries in it live as long as their `Machine`."""
    return llvm.create_lljit_compiler(_target_machine(), use_jit_link=True)


def machine(text: str, names) -> Machine:
    """Machine code for this text, from the disk where it was compiled before."""
    path = _cached(text)
    data = _read(path)
    if data is None:
        data = compile_text(text)
        _write(path, data)
    return Machine(data, names)


def compile_text(text: str) -> bytes:
    """Optimises and generates code. LLVM's own vectorisers stay off: the text is vectors."""
    target = _target_machine()
    module = llvm.parse_assembly(text)
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = False
    options.slp_vectorization = False
    options.loop_unrolling = False
    options.loop_interleaving = False
    builder = llvm.create_pass_builder(target, options)
    builder.getModulePassManager().run(module, builder)
    return target.emit_object(module)


def assembly(text: str) -> str:
    """The processor's instructions, for a reader."""
    target = _target_machine()
    module = llvm.parse_assembly(text)
    builder = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    return target.emit_assembly(module)


def _target_machine():
    name, features, _ = host()
    target = llvm.Target.from_default_triple()
    # Code and constants may be mapped far apart: the small model's 32-bit distances then overflow.
    return target.create_target_machine(
        cpu=name, features=features, opt=2, jit=True, codemodel=CODE_MODEL
    )


def _cached(text: str) -> Path:
    name, features, _ = host()
    digest = hashlib.sha256()
    for part in (
        text,
        CODE_MODEL,
        name,
        features,
        llvmlite.__version__,
        str(llvm.llvm_version_info),
    ):
        digest.update(part.encode())
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "snapo" / "kernels" / f"{digest.hexdigest()}.o"


def _read(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all; a disk that cannot be written is no reason to fail."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(data)
        os.replace(file.name, path)
    except OSError:
        pass
