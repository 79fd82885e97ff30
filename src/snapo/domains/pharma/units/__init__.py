"""The unit operations: a file each, found by `registry`.

A new unit is an `operation.Unit`: its table, ports, equations, balances and measures.
"""
