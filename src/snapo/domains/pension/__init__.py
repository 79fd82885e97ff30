"""Pension funds: assets, swaps and contributions decided month by month against the liabilities."""

from .domain import PensionFund

DOMAIN = PensionFund()
