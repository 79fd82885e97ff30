"""Inventories: orders of an item under random demand."""

from .domain import Inventory

DOMAIN = Inventory()
