"""All kinds of asset class and all models of the short rate, as the files of two folders register
them."""

import pkgutil
from importlib import import_module
from types import ModuleType

from . import assets, rates
from .assets.asset_class import KINDS
from .rates.short_rate import MODELS

__all__ = ["KINDS", "MODELS"]


def _import_all(package: ModuleType) -> None:
    for module in pkgutil.iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")


for folder in (assets, rates):
    _import_all(folder)
