"""Material from unit to unit: streams, the order of the flow, balances, the whole as a function."""
