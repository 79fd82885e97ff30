"""All models of the short rate: every file of this folder, imported."""

from ..registry import import_all
from .short_rate import MODELS

import_all(__package__ or "", __file__)

__all__ = ["MODELS"]
