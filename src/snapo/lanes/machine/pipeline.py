"""Machine code from text for this processor, by llvmlite (imported when it is first needed)."""

import hashlib
import importlib
import os
import re
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

OLDEST = (0, 50)  # the first release that was tested


@cache
def binding() -> Any:
    """`llvmlite.binding`, ready to make code for this processor."""
    llvm = importlib.import_module("llvmlite.binding")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    llvm.load_library_permanently("")
    return llvm


def unavailable() -> str | None:
    """The reason why there is no LLVM; None if there is one."""
    try:
        version = importlib.import_module("llvmlite").__version__
        if tuple(int(part) for part in re.findall(r"\d+", version)[:2]) < OLDEST:
            return f"llvmlite {version} is older than {'.'.join(map(str, OLDEST))}"
        binding()
    except ModuleNotFoundError:
        return "llvmlite is not installed"
    except (ImportError, OSError, RuntimeError) as error:
        return f"llvmlite cannot be loaded: {error}"
    return None


@cache
def available() -> bool:
    """Whether machine code can be made here."""
    return unavailable() is None


def versions() -> str:
    """The releases of llvmlite and of LLVM itself."""
    llvmlite = importlib.import_module("llvmlite")
    return f"{llvmlite.__version__} {binding().llvm_version_info}"


REGISTERS = 2  # per number and block: two chains side by side hide part of the latency


class Processor(NamedTuple):
    """A processor as LLVM describes it; `register`: the number of bytes of a vector register."""

    triple: str
    name: str
    features: str
    register: int

    def lanes(self, dtype: str) -> int:
        """The number of paths in one block: two vector registers."""
        return max(1, self.register // np.dtype(dtype).itemsize) * REGISTERS


PROCESSOR = "SNAPO_PROCESSOR"  # the variable that names the target of all code
LEVELS = {"x86-64-v2": 16, "x86-64-v3": 32, "x86-64-v4": 64}  # and bytes of a vector register


@cache
def actual() -> Processor:
    """The processor that this process runs on."""
    llvm = binding()
    features = llvm.get_host_cpu_features()
    wide = features.get("avx512f") and features.get("avx512dq") and features.get("avx512vl")
    register = 64 if wide else 32 if features.get("avx2") else 16
    name = llvm.get_host_cpu_name()
    return Processor(llvm.get_default_triple(), name, features.flatten(), register)


@cache
def host() -> Processor:
    """The processor that code is made for: the actual one, or the level that `PROCESSOR` names."""
    level = os.environ.get(PROCESSOR)
    if not level:
        return actual()
    return Processor(actual().triple, level, "", LEVELS[level])


def use_processor(level: str) -> bool:
    """From now on compiles all code of this process for a level of `LEVELS`, with the same bits on
    every processor of that level; False if this processor does not support it."""
    if not actual().triple.startswith("x86_64") or actual().register < LEVELS[level]:
        return False
    if os.environ.get(PROCESSOR) != level:
        os.environ[PROCESSOR] = level
        host.cache_clear()
    return True


def fingerprint() -> str:
    """A name for all properties of this processor that affect the bits of results."""
    processor = actual()
    text = f"{processor.triple} {processor.name} {processor.features}"
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


@dataclass(frozen=True)
class Pipeline:
    """The stages of code generation: LLVM's vectorisers stay off, as the text consists of vectors.

    Code and constants may be mapped far apart: the small code model's 32-bit distances then
    overflow.
    """

    speed_level: int = 2
    code_level: int = 2
    code_model: str = "large"
    loop_vectorization: bool = False
    slp_vectorization: bool = False
    loop_unrolling: bool = False
    loop_interleaving: bool = False

    def identity(self) -> str:
        """All that determines the code in addition to the text: code under another identity is not
        used."""
        processor = host()
        settings = " ".join(f"{key}={value}" for key, value in asdict(self).items())
        parts = (settings, processor.triple, processor.name, processor.features, versions())
        return "\n".join(parts)

    def target(self) -> Any:
        """LLVM's target machine: this processor with all its features."""
        llvm, processor = binding(), host()
        return llvm.Target.from_triple(processor.triple).create_target_machine(
            cpu=processor.name,
            features=processor.features,
            opt=self.code_level,
            jit=True,
            codemodel=self.code_model,
        )

    def optimised(self, text: str, target: Any) -> Any:
        """The module after all passes."""
        llvm = binding()
        module = llvm.parse_assembly(text)
        module.verify()
        options = llvm.create_pipeline_tuning_options(speed_level=self.speed_level)
        options.loop_vectorization = self.loop_vectorization
        options.slp_vectorization = self.slp_vectorization
        options.loop_unrolling = self.loop_unrolling
        options.loop_interleaving = self.loop_interleaving
        builder = llvm.create_pass_builder(target, options)
        builder.getModulePassManager().run(module, builder)
        return module


PIPELINE = Pipeline()


def object_code(text: str) -> bytes:
    """Machine code for a module's text, ready to be linked."""
    target = PIPELINE.target()
    return target.emit_object(PIPELINE.optimised(text, target))


def assembly(text: str) -> str:
    """The instructions of `object_code`, for a reader."""
    target = PIPELINE.target()
    return target.emit_assembly(PIPELINE.optimised(text, target))
