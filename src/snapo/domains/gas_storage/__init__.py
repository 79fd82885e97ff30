"""Gas storage: a contract on gas in store, valued and steered; light until there is work to do."""

from .domain import GasStorage

DOMAIN = GasStorage()
