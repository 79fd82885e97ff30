"""The versions that decide the numbers."""

import platform
from importlib.metadata import PackageNotFoundError, version

LIBRARIES = ("snapo", "jax", "jaxlib", "equinox", "optax", "numpy", "scipy", "llvmlite", "diffrax")


def versions() -> dict[str, str]:
    """What decides the numbers besides the inputs: this package, its libraries and the machine."""
    table = {"python": platform.python_version(), "machine": platform.machine()}
    for name in LIBRARIES:
        try:
            table[name] = version(name)
        except PackageNotFoundError:
            table[name] = "not installed"
    return table
