"""The methods of valuation: each reads levels, modes, moves and cash, and serves all contracts."""
