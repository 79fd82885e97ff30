"""One file per kind: a folder whose files register their kind when they are imported."""

import pkgutil
from importlib import import_module
from pathlib import Path


def import_all(package: str, file: str) -> None:
    """Imports every file of the folder of `file`, which is the package `package`."""
    for module in pkgutil.iter_modules([str(Path(file).parent)]):
        import_module(f"{package}.{module.name}")
