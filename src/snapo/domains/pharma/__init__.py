"""Pharmaceutical processes: `DOMAIN` is how the commands know them."""

from .domain import DOMAIN as DOMAIN
