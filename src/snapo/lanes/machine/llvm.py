"""llvmlite, imported when it is first needed: everything else runs without it."""

import importlib
import re
from functools import cache
from typing import Any

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
    """The reason why there is no LLVM; None where there is one."""
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


def versions() -> str:
    """The releases of llvmlite and of LLVM itself."""
    llvmlite = importlib.import_module("llvmlite")
    return f"{llvmlite.__version__} {binding().llvm_version_info}"
