"""Smooth Neural Adjoint Policy Optimization: decisions under uncertainty, with every gradient.

The public names are listed in `__init__.pyi`. They are loaded when first used, so that
`snapo --help` need not load JAX.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.1.0"
MODULES = ("noise", "log")  # public names that are modules, such as `snapo.noise.Poisson`


@cache
def _homes() -> dict[str, str]:
    """{public name: module}, from the imports of `__init__.pyi`."""
    import ast  # late: it takes longer than all of `snapo --help`

    text = Path(__file__).with_name("__init__.pyi").read_text(encoding="utf-8")
    listed = ast.parse(text)
    imports = [node for node in listed.body if isinstance(node, ast.ImportFrom)]
    return {name.name: str(node.module) for node in imports for name in node.names}


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return ["__version__", *_homes()]
    # Names with underscores are asked for by Python itself, on every import of a submodule.
    if name.startswith("_") or name not in _homes():
        raise AttributeError(f"module 'snapo' has no attribute {name!r}")
    home = _homes()[name]
    if name in MODULES:
        return import_module(f"{home}.{name}")
    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_homes()])
