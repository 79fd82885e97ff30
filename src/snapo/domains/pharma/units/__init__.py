"""The unit operations: a file each, found by `registry`.

A new one is an `operation.Unit`: its table, ports, equations, balances and measures.
"""
