"""All kinds of asset classes: every file of this folder, imported."""

from ..registry import import_all
from .asset_class import KINDS

import_all(__package__ or "", __file__)

__all__ = ["KINDS"]
