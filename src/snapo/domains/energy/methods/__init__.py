"""The methods of valuation; each uses only levels, modes, moves and cash, and therefore works for
all contracts."""
